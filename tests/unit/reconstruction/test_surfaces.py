"""Depth of plain regions from their borders, and the judgement of poses that a plain room passes."""

from dataclasses import replace

import numpy as np
import pytest

from acquisition.scenes.catalog import build_scene
from reconstruction.errors import StereoError
from reconstruction.images.noise import pixel_spread, still_sigma
from reconstruction.initialization.pyramid import swept_maps
from reconstruction.initialization.surfaces import inferred, regions, with_planes
from reconstruction.initialization.sweep import DepthMap, SweepOptions, depth_range_m
from reconstruction.initialization.texture import PLAIN_SHARE, judge_poses, spread_of, textured, thinned
from rigs.camera import Camera
from rigs.toml import catalog_rig
from rigs.transform import Transform

H, W = 60, 83
OPTIONS = SweepOptions(1.0, 8.0)
STEP = float(np.diff(OPTIONS.inverse_depths[:2])[0])
CAMERA = Camera("cam00", W, H, 80.0, 80.0, W / 2, H / 2, Transform.identity())
NOISE = np.full((H, W), 0.004, np.float32)
OUTER = ("cam00", "cam01", "cam02", "cam10", "cam12", "cam20", "cam21", "cam22")


def wall(slope=0.002):
    """Return the depth of a slanted wall [H, W] and a plain picture of it between brighter borders."""
    rows, columns = np.indices((H, W))
    inverse = 0.4 + slope * (columns - W / 2) + 0.001 * rows
    image = np.full((H, W), 0.3, np.float32)
    image[:8], image[-8:], image[:, :8], image[:, -8:] = 0.5, 0.5, 0.5, 0.5
    return (1 / inverse).astype(np.float32), image


def at_edges(depth, noise_steps=0.2, seed=0):
    """Return the depths at the borders of the plain part alone, with noise in inverse depth."""
    rng = np.random.default_rng(seed)
    known = np.full_like(depth, np.nan)
    frame = np.zeros((H, W), bool)
    frame[5:-5, 5:-5] = True
    frame[11:-11, 11:-11] = False
    noisy = 1 / (1 / depth + noise_steps * STEP * rng.standard_normal(depth.shape))
    known[frame] = noisy[frame]
    return DepthMap(CAMERA, known.astype(np.float32), np.zeros_like(depth))


def test_a_plain_wall_is_the_plane_of_its_border():
    depth, image = wall()
    found = inferred(at_edges(depth), image, NOISE, OPTIONS, np.random.default_rng(0))
    inside = (slice(11, -11), slice(11, -11))
    assert np.isnan(at_edges(depth).depth[inside]).all()
    np.testing.assert_allclose(found.depth[inside], depth[inside], rtol=0.01)


def test_what_hides_a_part_of_the_border_does_not_bend_the_wall():
    depth, image = wall()
    hidden = depth.copy()
    hidden[:, : W // 3] = 1.2
    found = inferred(at_edges(hidden), image, NOISE, OPTIONS, np.random.default_rng(0))
    inside = (slice(11, -11), slice(11, -11))
    np.testing.assert_allclose(found.depth[inside], depth[inside], rtol=0.01)


def test_a_border_that_contradicts_itself_says_nothing():
    depth, image = wall()
    guessed = (1 / np.random.default_rng(1).uniform(0.15, 0.9, depth.shape)).astype(np.float32)
    before = at_edges(guessed)
    after = inferred(before, image, NOISE, OPTIONS, np.random.default_rng(0))
    np.testing.assert_array_equal(after.depth, before.depth)


@pytest.mark.parametrize("depth", [np.nan, 2.0, np.inf])
@pytest.mark.parametrize("size", [(1, 1), (3, 60), (60, 83)])
def test_nothing_known_or_everything_known_stays_as_it_is(depth, size):
    before = DepthMap(CAMERA, np.full(size, depth, np.float32), np.zeros(size, np.float32))
    image = np.zeros(size, np.float32)
    after = inferred(before, image, np.full(size, 0.004, np.float32), OPTIONS, np.random.default_rng(0))
    np.testing.assert_array_equal(after.depth, before.depth)


@pytest.mark.parametrize("gap", [0, 4, 8])
def test_two_regions_that_a_gap_joins_are_told_apart(gap):
    smooth = np.ones((H, W), np.bool_)
    smooth[:, 40:42] = False
    smooth[10 : 10 + gap, 40:42] = True
    found = regions(smooth)
    assert found[30, 10] != found[30, 70]
    assert ((found > 0) == smooth)[:, :38].all()
    away = np.abs(np.indices((H, W))[1] - 41) > 6
    assert len(np.unique(found[smooth & away])) == 2


def test_a_gap_as_wide_as_a_region_joins_it():
    smooth = np.ones((H, W), np.bool_)
    smooth[:20, 40:42] = False
    assert len(np.unique(regions(smooth)[smooth])) == 1


@pytest.mark.parametrize("shape", [(1, 1), (3, 50), (8, 8), (H, W)])
def test_no_smooth_pixel_or_too_few_are_no_region(shape):
    assert not regions(np.zeros(shape, np.bool_)).any()
    speck = np.zeros(shape, np.bool_)
    speck[0, 0] = True
    assert not regions(speck).any()


def test_the_spread_is_that_of_numpy():
    image = np.random.default_rng(0).random((40, 30)).astype(np.float32)
    windows = np.lib.stride_tricks.sliding_window_view(image, (7, 7))
    np.testing.assert_allclose(spread_of(image, 3)[3:-3, 3:-3], windows.std(axis=(2, 3)), rtol=1e-5)
    assert spread_of(np.full((9, 9), 0.3, np.float32), 3).max() < 1e-7


@pytest.mark.parametrize("spread", [0.01, 0.03, 0.1])
def test_the_spread_of_pixels_is_found_beside_texture(spread):
    rng = np.random.default_rng(0)
    light = np.tile(np.linspace(0.2, 0.4, 240), (125, 1))
    light[:, :80] += 0.1 * rng.random((125, 80))  # a third of the picture has texture
    seen = (light * (1 + spread * rng.standard_normal(light.shape))).astype(np.float32)
    assert pixel_spread(seen, 4000, np.ones(seen.shape, bool)) == pytest.approx(spread, rel=0.15)


@pytest.mark.parametrize("image", [np.zeros((40, 50)), np.zeros((1, 1)), np.full((40, 50), 0.3), np.ones((16, 90))])
def test_pixels_without_light_or_all_alike_have_no_spread(image):
    assert pixel_spread(image.astype(np.float32), 400, np.ones(image.shape, bool)) == 0.0
    assert pixel_spread(np.full((40, 50), 0.3, np.float32), 400, np.zeros((40, 50), bool)) == 0.0


@pytest.fixture(scope="module")
def room():
    """Return cameras, images, noises and true depths of a plain room without its movers."""
    scene = build_scene("plain", 1)
    scene = replace(scene, bodies=tuple(body for body in scene.bodies if not body.moving))
    cameras = [c.scaled(200, 125) for c in catalog_rig("lab3x3").cameras if c.id in OUTER]
    frames = [scene.render(camera, np.zeros(1), 2) for camera in cameras]
    rng, depths = np.random.default_rng(0), [frame.depth[0] for frame in frames]
    noises = [still_sigma(frame.intensity[0], 400, np.ones((125, 200), bool)) for frame in frames]
    images = [
        (frame.intensity[0] + noise * rng.standard_normal(noise.shape)).astype(np.float32)
        for frame, noise in zip(frames, noises, strict=True)
    ]
    return cameras, images, noises, depths


def swept(cameras, images, noises):
    options = SweepOptions(*depth_range_m(cameras))
    sure = [textured(image, noise, options) for image, noise in zip(images, noises, strict=True)]
    return swept_maps(cameras, images, options), sure, options


def test_a_plain_room_passes_and_its_walls_are_where_they_are(room):
    cameras, images, noises, depths = room
    maps, sure, options = swept(cameras, images, noises)
    assert np.mean([np.isfinite(m.depth).mean() for m in maps]) < 0.5  # most of it says nothing
    assert "texture" in judge_poses(maps, sure)
    walls = with_planes(maps, images, noises, sure, options, np.random.default_rng(0))
    off = np.concatenate([np.abs(m.depth / d - 1).ravel() for m, d in zip(walls, depths, strict=True)])
    assert np.isfinite(off).mean() > 0.7
    assert np.nanmedian(off) < 0.01
    assert np.nanmean(off) < 0.04


def test_shuffled_poses_of_a_plain_room_are_refused(room):
    cameras, images, noises, _ = room
    shuffled = [cameras[i] for i in (2, 4, 3, 6, 5, 0, 1, 7)]
    maps, sure, _ = swept(shuffled, images, noises)
    with pytest.raises(StereoError, match=r"with texture, expected 40%; check the poses"):
        judge_poses(maps, sure)


def test_an_empty_picture_is_refused():
    blank = [DepthMap(CAMERA, np.full((H, W), np.nan, np.float32), np.ones((H, W), np.float32))]
    with pytest.raises(StereoError, match=r"texture in 0\.00%"):
        judge_poses(blank, [np.zeros((H, W), bool)])


def test_textured_views_keep_their_depths_to_the_bit():
    depth, image = wall()
    maps = [DepthMap(CAMERA, depth, np.zeros_like(depth))] * 3
    sure = [np.ones((H, W), bool)] * 3
    after = with_planes(maps, [image] * 3, [NOISE] * 3, sure, OPTIONS, np.random.default_rng(0))
    assert all(a.depth is m.depth for a, m in zip(after, maps, strict=True))


@pytest.mark.parametrize(
    ("textured_columns", "most", "count"),
    [(40, 4000, 4000), (40, 100, 100), (4, 4000, 850), (4, 500, 170), (0, 4000, 500), (0, 1, 1)],
)
def test_a_plain_scene_gets_fewer_points_and_its_texture_no_fewer(textured_columns, most, count):
    wanted, sure = [np.ones((50, 40), bool)] * 3, np.zeros((50, 40), bool)
    sure[:, :textured_columns] = True
    masks, found = thinned(wanted, [sure] * 3, most, np.random.default_rng(0))
    assert found == pytest.approx(count, rel=0.1)
    assert all(mask[sure].all() for mask in masks)
    plain = np.mean([mask[~sure].mean() for mask in masks]) if textured_columns < 40 else PLAIN_SHARE
    assert plain == pytest.approx(PLAIN_SHARE, rel=0.2)


def test_pixels_that_are_not_wanted_stay_out():
    wanted, sure = np.zeros((50, 40), bool), np.ones((50, 40), bool)
    masks, count = thinned([wanted] * 2, [sure] * 2, 1000, np.random.default_rng(0))
    assert count == 0
    assert not np.any(masks)
