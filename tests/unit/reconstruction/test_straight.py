"""The way between a camera whose lens bends and its view, against dense matrices and functions known everywhere."""

from dataclasses import replace

import numpy as np
import pytest
from references.lenses import read_between_reference

from acquisition.native import code_path, code_paths
from reconstruction.lenses.resampling import REACH, Reading, readings
from reconstruction.lenses.straight import overlaps, straightening, view_of, views_of
from rigs.camera import Camera
from rigs.errors import RigError
from rigs.rig import Rig
from rigs.transform import Transform

LENSES = {
    "barrel": ("opencv", (-0.18, 0.0, 0.0, 0.0)),
    "pincushion": ("opencv", (0.18, 0.02, 0.003, -0.002)),
    "fisheye": ("fisheye", (0.0, 0.0, 0.0, 0.0)),
}


def bent_camera(name: str, width: int = 100, height: int = 63) -> Camera:
    model, k = LENSES[name]
    focal = 0.875 * width
    lens = {"distortion": k, "lens_model": model}
    return Camera("cam00", width, height, focal, focal, 0.52 * width, 0.47 * height, Transform.identity(), **lens)


def scene(slopes: np.ndarray) -> np.ndarray:
    """Return a smooth light [...] of slopes [..., 2], with a period of six pixels at least."""
    x, y = slopes[..., 0] * 87.5, slopes[..., 1] * 87.5
    return 0.5 + 0.2 * np.sin(x / 1.1) * np.cos(y / 1.3) + 0.1 * np.sin(0.4 * x + 0.3 * y)


def middles(camera: Camera) -> np.ndarray:
    rows, columns = np.indices((camera.height, camera.width)) + 0.5
    places = np.stack([columns.ravel(), rows.ravel()], axis=1)
    return camera.slopes(places).reshape(camera.height, camera.width, 2)


@pytest.mark.parametrize("name", LENSES)
def test_charge_is_kept_and_even_light_stays_even(name):
    camera = bent_camera(name)
    way = straightening(camera, view_of(camera))
    counts = np.random.default_rng(0).poisson(3.0, (camera.height, camera.width))
    assert way.charge(counts).sum(dtype=np.float64) == pytest.approx(counts.sum(), rel=1e-6)
    for value in (0.0, 1.0, 1e-20, 1e20):
        even = way.light(np.full((camera.height, camera.width), value))
        np.testing.assert_allclose(even, value, rtol=1e-5)
    np.testing.assert_allclose(way.charge(counts), way.exposure * way.light(counts), rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize(("name", "size"), [("barrel", (26, 19)), ("pincushion", (13, 11)), ("barrel", (1, 1))])
def test_the_way_is_the_matrix_it_says_it_is(name, size):
    camera = bent_camera(name, *size)
    view = view_of(camera)
    way = straightening(camera, view)
    units = np.eye(camera.width * camera.height).reshape(-1, camera.height, camera.width)
    matrix = np.stack([way.charge(unit).ravel() for unit in units], axis=1).astype(np.float64)  # [Q, P]
    np.testing.assert_allclose(matrix.sum(axis=0), 1, rtol=0, atol=2e-6)
    image = np.random.default_rng(1).random((camera.height, camera.width))
    total, seen_at = matrix.sum(axis=1), way.covered
    seen = seen_at.ravel()
    light = (matrix @ image.ravel())[seen] / total[seen]
    np.testing.assert_allclose(way.light(image).ravel()[seen], light, rtol=2e-5)
    noise = np.sqrt((matrix**2).sum(axis=1))[seen] / total[seen]
    whole = np.zeros((size[1], size[0]), bool)
    whole[REACH + 1 : -REACH - 1, REACH + 1 : -REACH - 1] = True
    inner = ~way.touched(~whole)[seen_at]
    found = way.noise.ravel()[seen]
    np.testing.assert_allclose(found[inner], noise[inner], rtol=2e-5)
    assert np.abs(found / noise - 1).max(initial=0.0) < 0.36  # at the edge, which stands in for what lies beyond
    np.testing.assert_allclose(way.exposure.ravel(), total, atol=1e-5)
    part = np.s_[1:3, 0:2] if min(view.height, view.width) > 3 else np.s_[:, :]
    np.testing.assert_array_equal(way.light(image, part), way.light(image)[part])


def test_the_noise_is_that_of_independent_pixels():
    camera = bent_camera("barrel")
    way = straightening(camera, view_of(camera))
    rng = np.random.default_rng(0)
    some = np.stack([way.light(rng.normal(size=(camera.height, camera.width))) for _ in range(400)])
    off = some.std(axis=0)[way.covered] / way.noise[way.covered]
    assert abs(off.mean() - 1) < 0.01
    assert off.std() < 0.045  # 1 / sqrt(800) is 0.035


@pytest.mark.parametrize("name", LENSES)
def test_light_known_everywhere_is_found_in_the_view_and_back(name):
    camera = bent_camera(name)
    view = view_of(camera)
    way = straightening(camera, view)
    inner = way.covered & ~way.touched(np.pad(np.zeros((55, 92), bool), 4, constant_values=True))
    found, wanted = way.light(scene(middles(camera))), scene(middles(view))
    assert np.abs(found - wanted)[inner].max() < 0.004  # of a contrast of 0.6; means over areas err by 0.05
    back = way.bent(wanted.astype(np.float32))
    assert np.abs(back - scene(middles(camera)))[4:-4, 4:-4].max() < 0.003
    depth = way.nearest(np.arange(view.width * view.height).reshape(view.height, view.width))
    rows, columns = np.divmod(depth, view.width)
    places = camera.straightened(np.stack(np.meshgrid(np.arange(100) + 0.5, np.arange(63) + 0.5), -1).reshape(-1, 2))
    apart = np.stack([columns, rows], -1).reshape(-1, 2) + 0.5 + (camera.cx - view.cx, camera.cy - view.cy) - places
    assert np.abs(apart).max() < 0.5001


@pytest.mark.parametrize("name", LENSES)
def test_the_view_covers_the_picture_at_the_scale_of_its_centre(name):
    camera = bent_camera(name)
    view = view_of(camera)
    assert (view.fx, view.fy) == (camera.fx, camera.fy)
    assert not view.bends
    rows, columns = np.indices((64, 101), dtype=np.float64)
    places = camera.straightened(np.stack([columns.ravel(), rows.ravel()], axis=1))
    inside = places - (camera.cx - view.cx, camera.cy - view.cy)
    assert inside.min() >= -1e-6
    assert (inside.max(axis=0) <= (view.width + 1e-6, view.height + 1e-6)).all()
    assert (inside.min(axis=0) < 1).all()
    assert (inside.max(axis=0) > (view.width - 1, view.height - 1)).all()


def test_masks_go_both_ways():
    camera = bent_camera("barrel")
    way = straightening(camera, view_of(camera))
    mask = np.zeros((63, 100), bool)
    mask[20:30, 40:60] = True
    seen = way.touched(mask)
    assert 200 <= seen.sum() < 320  # grown by its border
    assert (way.touching(seen) & mask).sum() == mask.sum()
    assert not way.touching(np.zeros(way.covered.shape, bool)).any()
    assert way.touching(np.ones(way.covered.shape, bool)).all()


def test_overlaps_are_areas():
    rng = np.random.default_rng(2)
    turn = rng.uniform(0, 2 * np.pi, 40)
    corners = np.array([[-0.7, -0.6], [0.7, -0.5], [0.8, 0.6], [-0.6, 0.7]])
    rotation = np.stack([np.stack([np.cos(turn), -np.sin(turn)], -1), np.stack([np.sin(turn), np.cos(turn)], -1)], -2)
    quads = corners @ rotation.swapaxes(1, 2) + rng.uniform(2, 7, (40, 1, 2))
    giver, taker, area = overlaps(quads, 10)
    x, y = np.moveaxis(quads, -1, 0)
    shoelace = 0.5 * np.abs((x * np.roll(y, -1, 1) - y * np.roll(x, -1, 1)).sum(axis=1))
    np.testing.assert_allclose(np.bincount(giver, area), shoelace, rtol=1e-12)
    fine = (np.stack(np.meshgrid(np.arange(2000), np.arange(2000)), -1) + 0.5) / 200  # 200 points a side of a pixel
    edges = np.roll(quads[0], -1, 0) - quads[0]
    off = fine[..., None, :] - quads[0]
    inside = (edges[:, 0] * off[..., 1] - edges[:, 1] * off[..., 0] > 0).all(axis=-1)
    wanted = inside.reshape(10, 200, 10, 200).mean(axis=(1, 3)).ravel()
    np.testing.assert_allclose(np.bincount(taker[giver == 0], area[giver == 0], 100), wanted, atol=1e-3)
    square = np.array([[[2.0, 3], [3, 3], [3, 4], [2, 4]]])
    assert [a.tolist() for a in overlaps(square, 10)] == [[0], [32], [1.0]]


def test_readings_are_lanczos_sums():
    rng = np.random.default_rng(3)
    picture = rng.random((9, 12)).astype(np.float32)
    places = rng.uniform(-1, 13, (5, 7, 2))
    reading = Reading.at(places, picture.shape)
    padded = np.pad(picture.astype(np.float64), 20, mode="edge")
    wanted = np.zeros((5, 7))
    for spot in np.ndindex(5, 7):
        x, y = np.clip(places[spot], 0, (12, 9)) - 0.5
        across, down = (np.arange(np.floor(v) + 1 - REACH, np.floor(v) + 1 + REACH) for v in (x, y))
        wx, wy = (np.sinc(v - t) * np.sinc((v - t) / REACH) for v, t in ((x, across), (y, down)))
        window = padded[np.ix_(down.astype(int) + 20, across.astype(int) + 20)]
        wanted[spot] = (wy / wy.sum()) @ window @ (wx / wx.sum())
    np.testing.assert_allclose(reading(picture), wanted, atol=1e-5)
    values = rng.random((5, 7))
    given = reading.spread(values)
    assert given.ravel() @ picture.ravel() == pytest.approx(float((values * wanted).sum()), rel=1e-5)  # the adjoint


@pytest.mark.parametrize("size", [(1, 1), (3, 5), (17, 23)])
def test_a_part_is_read_as_the_whole_is(size):
    rng = np.random.default_rng(4)
    picture = rng.random(size).astype(np.float32)
    reading = Reading.at(rng.uniform(-1, max(size) + 1, (6, 11, 2)), size)
    whole, one = reading(picture), np.zeros((6, 11), bool)
    one[3, 7] = True
    with pytest.raises(ValueError, match="found a picture of"):
        reading(np.zeros((size[0] + 1, size[1]), np.float32))
    for part in (np.zeros((6, 11), bool), one, rng.random((6, 11)) < 0.5, np.s_[2:5, 1:9], np.s_[1:1, :], np.s_[4:]):
        np.testing.assert_array_equal(reading(picture, part), whole[part])


@pytest.mark.parametrize("path", code_paths())
@pytest.mark.parametrize("scale", [0.0, 1e-30, 1.0, 1e30])
def test_every_build_reads_sums_at_any_scale_and_spreads_no_further_what_is_no_number(path, scale):
    rng = np.random.default_rng(5)
    picture = (rng.random((20, 31)) * scale).astype(np.float32)
    reading = Reading.at(rng.uniform(0, 31, (13, 9, 2)), picture.shape)
    with code_path(path):
        np.testing.assert_allclose(
            reading(picture), read_between_reference(reading, picture), rtol=1e-5, atol=1e-6 * scale
        )
        picture[3, 5] = np.nan
        np.testing.assert_array_equal(np.isnan(reading(picture)), np.isnan(read_between_reference(reading, picture)))


def test_sparse_places_stand_for_means():
    few = readings(lambda places: places * 3.0, (4, 5), (12, 15))
    assert len(few) == 4
    picture = np.random.default_rng(0).random((12, 15)).astype(np.float32)
    mean = np.mean([one(picture) for one in few], axis=0)
    wanted = picture.reshape(4, 3, 5, 3).mean(axis=(1, 3))
    assert np.corrcoef(mean.ravel(), wanted.ravel())[0, 1] > 0.9


def test_cameras_that_differ_get_views_of_one_size_and_pinholes_alone_stay_as_they_are():
    plain = replace(bent_camera("barrel"), id="cam01", distortion=(0.0,) * 4, fx=90.0, cx=48.0)
    bent = replace(bent_camera("fisheye"), id="cam00")
    assert view_of(plain) is plain
    rig = Rig("two", 20000.0, (bent, plain), "calibrated")
    views = views_of(rig, rig.ids)
    assert {(v.width, v.height) for v in views.values()} == {(views["cam00"].width, views["cam00"].height)}
    way = straightening(plain, views["cam01"])
    image = np.random.default_rng(0).random((63, 100)).astype(np.float32)
    np.testing.assert_allclose(way.light(image)[way.covered], image.ravel(), atol=1e-6)
    np.testing.assert_allclose(way.bent(way.light(image)), image, atol=1e-6)
    alone = replace(rig, cameras=(plain,))
    assert views_of(alone, ["cam01"])["cam01"] is plain


@pytest.mark.parametrize(
    ("distortion", "model", "words"),
    [
        ((-1.5, 0, 0, 0), "opencv", "cam00: found a lens that folds 25.2 degrees off its axis, inside the picture"),
        ((-0.6, 0, 0, 0), "fisheye", "folds"),
        ((-0.35, 0, 0, 0), "fisheye", "cam00: found a lens that sees 85 degrees off its axis"),
        ((40, 0, 0, 0), "opencv", "cam00: found a lens whose picture is 37x30 pixels of a pinhole"),
    ],
)
def test_lenses_that_no_view_covers_are_refused(distortion, model, words):
    camera = replace(bent_camera("barrel"), lens_model=model, distortion=distortion)
    if "sees" in words:
        camera = replace(camera, fx=45.0, fy=45.0, distortion=(0.0,) * 4, width=110)
    with pytest.raises(RigError, match=words):
        view_of(camera)
