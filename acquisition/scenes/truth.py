"""Writes `truth/` of a simulated recording: exact light, depth, objects and cameras beside the spikes.

Every k-th plane of each camera has four images [H, W]: `camRC/000120.npy` (float32, the light at (120 + 0.5) / rate),
`depth_000120.npy` (float32), `id_000120.npy` (int8) and `blur_000120.npy` (float32, the mean light of the exposure that
`scene.json` states, without noise). Viewpoints that no camera of the rig has are `novelN/`, without blur.
`cameras.json` is nerfstudio's and exact. The light is the paper's clean frame (CI), the blur its blurred frame (BI).
`frame_000049.npy` (float32) is what an ordinary camera reads of the exposure around its plane; it is no truth.
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import chain
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from acquisition.arrays import write_array
from acquisition.durable import write_durably, write_json
from acquisition.errors import BadRecordingError
from acquisition.progress import Progress, silent
from acquisition.scenes.ordinary import Exposure, OrdinaryCamera
from acquisition.scenes.view import Scenery, View
from acquisition.spikes.sensor import SensorKind
from rigs.camera import Camera
from rigs.exchange.nerfstudio import dump_transforms
from rigs.rig import Rig
from rigs.transform import Transform

BLUR_PLANES = 32  # exposure of a blurred frame, centred on the instant
BLUR_STRIDE = 4  # planes between the frames that the light of an exposure is the mean of
BLUR_SAMPLES = 2  # rays a side of a pixel of a blurred frame
DRAWN_AT_ONCE = 8  # frames of an exposure
EVERY, MOST_INSTANTS = 20, 200  # planes between true frames, and frames of a camera: 1.6 MB each at 400x250
ORDINARY = OrdinaryCamera()
_VIEW_IMAGES = 3  # of a plane: light, depth and objects
NOVEL_REACH = ((-0.5, -0.5), (1.25, -0.4))  # places in half widths of the rig: between the cameras, and beside them
Images = Iterator[tuple[str, NDArray]]  # names of files, and what they hold


def stride_of(planes: int) -> int:
    """Return the planes between true frames of a recording: EVERY, or as many times that as keep MOST_INSTANTS."""
    return EVERY * max(1, -(-planes // (EVERY * MOST_INSTANTS)))


def write_truth(
    scene: Scenery,
    rig: Rig,
    ticks: int,
    every: int,
    folder: Path,
    progress: Progress = silent,
    *,
    samples: int = 4,
    sensor: SensorKind = "real",
) -> None:
    """Fill the new `folder` with the truth of planes 0, `every`, ... below `ticks`, by samples x samples rays a pixel.

    Raises BadRecordingError where the folder exists or there is nothing to write, DiskError when the disk refuses.
    """
    if ticks < 1 or every < 1:
        raise BadRecordingError(f"found {ticks} ticks and truth every {every} planes", "at least 1 of each")
    if folder.exists():
        raise BadRecordingError("exists already", "a new folder", "move it away", where=folder)
    planes = list(range(0, ticks, every))
    exposures = exposures_of(rig.tick_rate_hz, ticks, len(planes))
    cameras = (*rig.cameras, *novel_cameras(scene, rig))
    for number, camera in enumerate(cameras):
        (folder / camera.id).mkdir(parents=True)
        images = _views(scene, rig, camera, planes, samples)
        count = _VIEW_IMAGES * len(planes)
        if camera.id in rig.ids:
            images = chain(images, _blurred(scene, rig, camera, planes), _frames(scene, rig, camera, exposures))
            count += len(planes) + len(exposures)
        for done, (file, image) in enumerate(images):
            progress((number + done / count) / len(cameras), f"truth of {camera.id}")
            write_array(folder / camera.id / file, image)
    write_durably(folder / "cameras.json", dump_transforms(cameras))
    write_json(folder / "scene.json", _description(scene, rig, ticks, every) | {"sensor": sensor, "samples": samples})
    progress(1.0, f"truth of {len(cameras)} views, {len(planes)} instants each")


def novel_cameras(scene: Scenery, rig: Rig) -> tuple[Camera, ...]:
    """Return viewpoints `novel0`, ... that look at the scene's centre with the lens of the rig's first camera."""
    centers = np.array([camera.center for camera in rig.cameras])
    middle = (centers.min(axis=0) + centers.max(axis=0)) / 2
    reach = np.maximum((centers.max(axis=0) - centers.min(axis=0)) / 2, 0.1)
    places = [middle + reach * (x, y, 0) for x, y in NOVEL_REACH]
    return tuple(
        replace(rig.cameras[0], id=f"novel{n}", serial="", cam_from_rig=Transform.looking_at(place, scene.center))
        for n, place in enumerate(places)
    )


def _views(scene: Scenery, rig: Rig, camera: Camera, planes: list[int], samples: int) -> Images:
    """Draw light, depth and objects at each of the planes."""
    view = scene.view(camera, samples)
    for plane in planes:
        frames = view.frames(np.array([rig.clock.instant_s(plane)]))
        for prefix, images in (("", frames.intensity), ("depth_", frames.depth), ("id_", frames.ids)):
            yield f"{prefix}{plane:06d}.npy", images[0]


def _blurred(scene: Scenery, rig: Rig, camera: Camera, planes: list[int]) -> Images:
    view = scene.view(camera, BLUR_SAMPLES)
    for plane in planes:
        yield f"blur_{plane:06d}.npy", _mean_light(view, rig, plane, BLUR_PLANES)


def _frames(scene: Scenery, rig: Rig, camera: Camera, exposures: list[Exposure]) -> Images:
    """Draw what an ordinary camera reads of each exposure."""
    view, index = scene.view(camera, BLUR_SAMPLES), rig.ids.index(camera.id)
    for exposure in exposures:
        light = _mean_light(view, rig, exposure.middle, exposure.planes)
        rng = np.random.default_rng([scene.seed, index, exposure.first])
        yield frame_file(exposure.middle), ORDINARY.read(light, scene.white, rng)


def frame_file(tick: int) -> str:
    """Return the name of the file of an ordinary camera's frame around a tick."""
    return f"frame_{tick:06d}.npy"


def exposures_of(tick_rate_hz: float, ticks: int, instants: int) -> list[Exposure]:
    """Return the exposures of the ordinary camera that are kept beside so many true instants.

    All are kept where they are no more than the instants and MOST_INSTANTS; otherwise no more than these, evenly.
    """
    return ORDINARY.exposures(tick_rate_hz, ticks, max(1, min(instants, MOST_INSTANTS)))


def _mean_light(view: View, rig: Rig, middle: int, count: int) -> NDArray[np.float32]:
    """Return the mean light [H, W] of `count` planes around one, of which every few are drawn."""
    stride = min(BLUR_STRIDE, count)
    offsets = np.arange(-count / 2 + stride / 2, count / 2, stride)
    offsets -= offsets.mean()
    total = np.zeros((), np.float64)
    for part in np.array_split(offsets, -(-len(offsets) // DRAWN_AT_ONCE)):
        instants_s = np.array([rig.clock.instant_s(middle + offset) for offset in part])
        total = total + view.light(instants_s).sum(axis=0, dtype=np.float64)
    return (total / len(offsets)).astype(np.float32)


def _description(scene: Scenery, rig: Rig, ticks: int, every: int) -> dict[str, object]:
    return {
        "scene": scene.name,
        "seed": scene.seed,
        "white": scene.white,
        "ticks": ticks,
        "tick_rate_hz": rig.tick_rate_hz,
        "every": every,
        "blur": {"window_ticks": BLUR_PLANES, "stride_ticks": BLUR_STRIDE, "samples": BLUR_SAMPLES},
        "ordinary": ORDINARY.description(rig.tick_rate_hz) | {"stride_ticks": BLUR_STRIDE, "samples": BLUR_SAMPLES},
        **scene.description(),
    }
