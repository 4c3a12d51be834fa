"""Defines cases of lenses that bend: the border of the picture, the fold, and pixels that are of no use under it."""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.packing import pack
from acquisition.spikes.stream import SpikeStream
from reconstruction.images.background import background
from reconstruction.images.catalogue import method
from reconstruction.images.composite import CompositeSource
from reconstruction.images.flicker import Light
from reconstruction.images.pixels import PixelCalibration
from reconstruction.images.response import NEVER, Response
from reconstruction.images.straightened import straightened
from reconstruction.lenses.straight import Straightening, straightening, view_of
from reconstruction.stability.case import Case, Observation, refusal
from rigs.camera import Camera
from rigs.lens import LensModel
from rigs.transform import Transform

SIZE, FOCAL_PX = (61, 43), 53.0  # width and height, as for the lab rig's field
PLANES, PERIOD = 160, 4  # planes of a clip, and ticks to a spike of every pixel
LENSES: dict[str, tuple[LensModel, tuple[float, ...]]] = {
    "10% barrel": ("opencv", (-0.22, 0.0, 0.0, 0.0)),
    "pincushion": ("opencv", (0.3, 0.05, 0.003, -0.002)),
    "fisheye": ("fisheye", (-0.02, 0.0, 0.0, 0.0)),
    "barrel that just does not fold": ("opencv", (-0.2988, 0.0, 0.0, 0.0)),
    "pincushion of 16": ("opencv", (16.0, 0.0, 0.0, 0.0)),
    "bend of 1e-300": ("opencv", (1e-300, 0.0, 0.0, 0.0)),
}
FACTORS = (0.0, 1e-30, 1.0, 1e30)  # of even light
Mask = NDArray[np.bool_]


def _camera(name: str, width: int = SIZE[0], height: int = SIZE[1]) -> Camera:
    model, numbers = LENSES[name]
    lens = {"distortion": numbers, "lens_model": model}
    return Camera("cam00", width, height, FOCAL_PX, FOCAL_PX, width / 2, height / 2, Transform.identity(), **lens)


def _way(camera: Camera) -> Straightening:
    return straightening(camera, view_of(camera))


def _places(camera: Camera) -> NDArray[np.float64]:
    """Return the corners and middles of all pixels on the border [N, 2] of a picture, in px."""
    x, y = np.arange(2 * camera.width + 1) / 2, np.arange(2 * camera.height + 1) / 2
    rows = [np.stack([x, np.full_like(x, edge)], axis=1) for edge in (0, camera.height)]
    columns = [np.stack([np.full_like(y, edge), y], axis=1) for edge in (0, camera.width)]
    return np.concatenate([*rows, *columns])


def _border(name: str) -> Observation:
    """Go from the border of the picture to the pinhole's and back."""
    camera = _camera(name)
    places = _places(camera)
    gap = np.abs(camera.bent(camera.straightened(places)) - places)
    return Observation(f"{len(places)} places, {gap.max():.0e} px off", _worst(gap))


def _even(name: str) -> Observation:
    """Straighten even light of any strength, and bend it back; the error is a share of it."""
    way, worst = _way(_camera(name)), 0.0
    for factor in FACTORS:
        there = way.light(np.full(way.size, factor, np.float32))
        back = way.bent(np.full(way.covered.shape, factor, np.float32))
        worst = max(
            worst, _worst(np.abs(there - factor)) / (factor or 1), _worst(np.abs(back - factor)) / (factor or 1)
        )
    return Observation(f"{way.covered.mean():.0%} of the view covered, {worst:.0e} off", worst)


def _charge(name: str) -> Observation:
    """Straighten counts of which all lie on the border, where the ways of pixels end."""
    way = _way(_camera(name))
    counts = np.random.default_rng(0).poisson(3.0, way.size)
    counts[1:-1, 1:-1] = 0
    gap = abs(float(way.charge(counts).sum(dtype=np.float64)) / counts.sum() - 1)
    noise = way.noise[way.covered]
    sane = bool(np.isfinite(way.noise).all()) and noise.min(initial=1) > 0 and way.exposure.min() >= -1e-3
    return Observation(f"{gap:.0e} of the charge lost", gap if sane else math.inf)


def _tiny(size: tuple[int, int]) -> Observation:
    """Straighten pictures of few pixels."""
    way = _way(_camera("10% barrel", *size))
    image = np.random.default_rng(0).random((size[1], size[0])).astype(np.float32)
    gap = abs(float(way.charge(image).sum(dtype=np.float64)) / float(image.sum()) - 1)
    finite = bool(np.isfinite(way.light(image)).all() and np.isfinite(way.bent(way.light(image))).all())
    return Observation(f"{way.covered.shape[1]}x{way.covered.shape[0]} pixels", gap if finite else math.inf)


def _nothing(_: str) -> Observation:
    """Straighten one pixel of NaN: what it reaches is NaN, all else is as without it."""
    way = _way(_camera("10% barrel"))
    image = np.random.default_rng(0).random(way.size).astype(np.float32)
    broken = image.copy()
    broken[20, 30] = np.nan
    seen, whole = way.light(broken), way.light(image)
    lost = np.isnan(seen)
    gap = np.abs(seen - whole)[~lost]
    return Observation(
        f"{lost.sum()} of {lost.size} pixels are NaN", _worst(gap) if 1 <= lost.sum() <= 144 else math.inf
    )


def _refused(numbers: tuple[float, ...], model: LensModel = "opencv") -> Observation:
    """Ask for the view of a lens that has none."""
    lens = {"distortion": numbers, "lens_model": model}
    error = refusal(lambda: view_of(Camera("cam00", *SIZE, 53.0, 53.0, 30.5, 21.5, Transform.identity(), **lens)))
    said = f"refused: {error}" if error and "\n" not in str(error) else "taken"
    return Observation(said, 0.0 if error else math.inf)


def _useless(where: str, name: str) -> Observation:
    """Look through a lens at an even clip with pixels of no use, by their map; gains differ by a third besides."""
    camera, rng = _camera(name), np.random.default_rng(2)
    shape = (camera.height, camera.width)
    bad = {"border": _rim(shape), "all but one": np.ones(shape, bool), "corner": np.zeros(shape, bool)}[where]
    if where == "corner":
        bad[:12, :12] = True
    elif where == "all but one":
        bad[20, 30] = False
    gain = rng.uniform(0.6, 1.6, shape).astype(np.float32)
    gain[bad] = rng.choice([1e-30, 1e30], int(bad.sum()))
    response = Response.calibrated(
        PixelCalibration(gain, np.zeros(shape, np.float32), bad & (gain > 1), bad & (gain < 1))
    )
    source = straightened(_clip(camera, np.where(bad, 1.0, gain / PERIOD), response), _way(camera))
    parts = source.background.image, source.counts(0, PLANES) / PLANES, source.at(PLANES // 2)
    marked = bool(source.useless(1)[~source.background.stuck].all()) if bad.all() else True
    worst = max(_worst(np.abs(part - 1 / PERIOD)) for part in parts)
    left_out = int((response.fails != NEVER).sum())
    good = marked and left_out == bad.sum()
    return Observation(f"{left_out} left out, light {worst:.0e} off", worst if good else math.inf)


def _rim(shape: tuple[int, int]) -> Mask:
    rim = np.ones(shape, bool)
    rim[3:-3, 3:-3] = False
    return rim


def _clip(camera: Camera, rate: NDArray[np.float64], response: Response) -> CompositeSource:
    """Return a still clip whose pixels fire at `rate` [H, W], each in its own phase."""
    ticks, phases = np.arange(PLANES + 1)[:, None, None], np.random.default_rng(3).random(rate.shape)
    spikes = np.diff(np.floor(ticks * rate + phases), axis=0).astype(np.uint8)
    layout = PlaneLayout(camera.width, camera.height)
    stream, light = SpikeStream(pack(spikes, layout), layout, 20000.0), Light.steady(PLANES)
    nowhere = np.zeros(rate.shape, bool)
    return CompositeSource(
        stream, background(stream, nowhere, light, response), nowhere, method("tfp"), light, response=response
    )


def _worst(gaps: NDArray[np.floating]) -> float:
    """Return the largest gap; infinity where one is not finite."""
    return float(gaps.max(initial=0.0)) if np.isfinite(gaps).all() else math.inf


def _each(said: str, expected: str, tolerance: float, observe: Callable[[str], Observation]) -> tuple[Case, ...]:
    """Return a case for each lens."""
    return tuple(
        Case(None, f"{name}: {said}", expected, tolerance, lambda _, name=name: observe(name)) for name in LENSES
    )


FOLDED = {
    "a lens that folds at the corner": (-0.2990, 0.0, 0.0, 0.0),
    "a lens with a bend of -1e9": (-1e9, 0.0, 0.0, 0.0),
    "a lens with a bend of 30": (30.0, 0.0, 0.0, 0.0),
    "a lens with a bend of 1e9": (1e9, 0.0, 0.0, 0.0),
    "a lens with a bend of 1e10": (1e10, 0.0, 0.0, 0.0),
    "a lens with a bend of NaN": (math.nan, 0.0, 0.0, 0.0),
}
CASES = (
    *_each("border of the picture, to the pinhole and back", "where it was", 1e-6, _border),
    *_each("even light of 0, 1e-30, 1 and 1e30", "even", 2e-6, _even),
    *_each("charge of the border alone", "kept", 2e-6, _charge),
    *(
        Case(None, f"a bent picture of {w}x{h}", "charge kept, finite", 2e-6, lambda _, size=(w, h): _tiny(size))
        for w, h in ((1, 1), (1, 9), (17, 1), (3, 2))
    ),
    Case(None, "a bent picture with a pixel of NaN", "NaN where it reaches, else as without", 1e-6, _nothing),
    *(
        Case(None, name, "refused in one line", 0.0, lambda _, numbers=numbers: _refused(numbers))
        for name, numbers in FOLDED.items()
    ),
    *(
        Case(
            None,
            f"{name}: pixels of no use, {where}",
            "light as the good ones",
            0.0125,
            lambda _, w=where, n=name: _useless(w, n),
        )
        for name in ("10% barrel", "fisheye")
        for where in ("border", "corner", "all but one")
    ),
)
