import json
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from reconstruction.errors import BadRunError
from reconstruction.evaluation.evaluate import score_floors
from reconstruction.evaluation.floors import confirmed, depth_blend, nearest_view
from reconstruction.initialization.sweep import SweepOptions
from reconstruction.metrics.image import psnr_db
from reconstruction.truth import Truth, spread
from rigs.camera import Camera
from rigs.transform import Transform

W, H = 96, 64


def camera_at(x, y):
    return Camera("view", W, H, 90.0, 90.0, W / 2, H / 2, Transform.looking_at((x, y, 0.0), (0, 0, 2.0)))


def see(camera, pattern):
    """Image and depth of the textured wall z = 2."""
    columns, rows = (np.arange(W) + 0.5 - camera.cx) / camera.fx, (np.arange(H) + 0.5 - camera.cy) / camera.fy
    rays = np.stack([*np.meshgrid(columns, rows), np.ones((H, W))], -1) @ camera.cam_from_rig.rotation
    depth = (2.0 - camera.center[2]) / rays[..., 2]
    points = camera.center + rays * depth[..., None]
    u, v = (points[..., 0] * 90 + 128).astype(np.float32), (points[..., 1] * 90 + 128).astype(np.float32)
    return cv2.remap(pattern, u, v, cv2.INTER_CUBIC), depth.astype(np.float32)


@pytest.fixture(scope="module")
def wall():
    noise = np.random.default_rng(0).random((256, 256)).astype(np.float32)
    pattern = cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 1.6), None, 0.05, 0.55, cv2.NORM_MINMAX)
    views = [(c, see(c, pattern)[0]) for c in (camera_at(x, y) for x, y in [(-0.2, 0), (0.2, 0), (0, -0.2), (0, 0.2)])]
    return views, camera_at(0.0, 0.0), see(camera_at(0.0, 0.0), pattern)


def test_the_nearest_view_is_an_image_of_a_training_camera(wall):
    views, wanted, _ = wall
    assert any(np.array_equal(nearest_view(wanted, views).intensity, image) for _, image in views)


def test_the_depth_blend_finds_the_wall_and_beats_the_nearest_view(wall):
    views, wanted, (truth, depth) = wall
    blend = depth_blend(wanted, views)
    assert psnr_db(blend.intensity, truth, 0.6) > psnr_db(nearest_view(wanted, views).intensity, truth, 0.6) + 8
    assert np.nanmedian(np.abs(blend.depth / depth - 1)) < 0.01


@pytest.mark.parametrize("odd", [0, 1])
def test_depth_is_swept_at_half_the_size_where_hypotheses_are_far_apart(wall, odd):
    views, wanted, _ = wall
    cut = [(replace(c, width=W - odd, height=H - odd), image[: H - odd, : W - odd]) for c, image in views]
    coarse, fine = (confirmed(cut, SweepOptions(1.0, 8.0, planes)) for planes in (14, 128))  # 2.4 px apart, and 0.25
    for camera, image in cut:
        one, other = coarse.pop(0), fine.pop(0)
        assert one.depth.shape == one.cost.shape == image.shape
        even = one.depth[: H - 2 * odd, : W - 2 * odd]
        assert np.array_equal(even[::2, ::2], even[1::2, 1::2], equal_nan=True)
        assert np.isnan(one.depth[H - 2 * odd :]).all()
        assert np.isfinite(even).mean() > 0.7
        assert not np.array_equal(other.depth[:60:2, :90:2], other.depth[1:60:2, 1:90:2], equal_nan=True)
        true = see(camera, np.zeros((256, 256), np.float32))[1][: H - odd, : W - odd]
        assert np.nanmedian(np.abs(one.depth / true - 1)) < 0.02
    assert depth_blend(wanted, views, (1.0, 8.0)).depth.shape == (H, W)


def test_the_span_of_a_blend_is_searched_and_no_other(wall):
    views, wanted, (_, depth) = wall
    assert np.nanmedian(np.abs(depth_blend(wanted, views, (1.5, 3.0)).depth / depth - 1)) < 0.01
    assert np.nanmax(depth_blend(wanted, views, (0.5, 1.5)).depth, initial=0) < 1.6


def test_a_blend_of_flat_views_is_that_light(wall):
    views, wanted, _ = wall
    flat = [(camera, np.full((H, W), 0.25, np.float32)) for camera, _ in views]
    assert np.allclose(depth_blend(wanted, flat).intensity, 0.25, atol=1e-6)


@pytest.mark.parametrize("count", [1, 2, 5, 40])
def test_spread_keeps_the_ends(count):
    planes = list(range(0, 400, 20))
    chosen = spread(planes, count)
    assert len(chosen) == min(count, 20)
    assert chosen[0] == 0
    assert chosen == sorted(set(chosen))
    assert count == 1 or chosen[-1] == 380


def truth_folder(path, planes=(0, 20)):
    (path / "cam11").mkdir(parents=True)
    (path / "scene.json").write_text(json.dumps({"white": 0.6, "movers": [{"id": 7, "name": "fan"}]}))
    for plane in planes:
        np.save(path / "cam11" / f"{plane:06d}.npy", np.full((4, 5), 0.3, np.float32))
        np.save(path / "cam11" / f"depth_{plane:06d}.npy", np.full((4, 5), 2.0, np.float32))
        np.save(path / "cam11" / f"id_{plane:06d}.npy", np.arange(20).reshape(4, 5).astype(np.int8))
    return path


def test_truth_is_read_with_its_movers(tmp_path):
    truth = Truth.open(truth_folder(tmp_path / "truth"))
    assert truth.planes("cam11") == [0, 20]
    frame = truth.frame("cam11", 20)
    assert frame.moving.sum() == 1
    assert frame.moving[1, 2]


def test_truth_ends_at_what_a_pixel_can_fire(tmp_path):
    folder = truth_folder(tmp_path / "truth")
    lamp = np.float16([[0.0, 0.5, 1.0, 1.5, 60000.0]])
    for name in ("000020", "blur_000020", "frame_000020"):
        np.save(folder / "cam11" / f"{name}.npy", lamp)
    truth = Truth.open(folder)
    expected = np.float32([[0.0, 0.5, 1.0, 1.0, 1.0]])
    for found in (truth.frame("cam11", 20).intensity, truth.blurred("cam11", 20), truth.ordinary("cam11", 20)):
        np.testing.assert_array_equal(found, expected)
    np.testing.assert_array_equal(replace(truth, gain=2.0).frame("cam11", 20).intensity, [[0, 1, 1, 1, 1]])


def test_truth_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(BadRunError, match=r"no usable scene\.json"):
        Truth.open(tmp_path)
    truth = Truth.open(truth_folder(tmp_path / "truth"))
    with pytest.raises(BadRunError, match="no truth of cam00"):
        truth.planes("cam00")
    (tmp_path / "truth" / "cam11" / "depth_000020.npy").write_bytes(b"")
    with pytest.raises(BadRunError, match="at plane 20"):
        truth.frame("cam11", 20)


@pytest.mark.parametrize(("lag_ticks", "expected"), [(0.0, [3, 9]), (-4.4, [7, 9]), (5.0, [0, 4])])
def test_floors_see_the_instant_of_the_truth(wall, lag_ticks, expected):
    views, wanted, (truth_light, depth) = wall
    asked = []

    def source(image):
        return SimpleNamespace(at=lambda plane: asked.append(plane) or image)

    frame = SimpleNamespace(intensity=truth_light, depth=depth, moving=np.zeros((H, W), bool))
    truth: Any = SimpleNamespace(
        planes=lambda _: [3, 9], frame=lambda *_: frame, lag_ticks=lag_ticks, white=0.6, metre=1.0, gain=1.0
    )
    held_out: Any = SimpleNamespace(camera=wanted, recording=SimpleNamespace(planes=10))
    sources: Any = {str(i): (camera, source(image)) for i, (camera, image) in enumerate(views)}
    scores = score_floors(held_out, truth, sources)
    assert sorted(set(asked)) == expected
    assert scores["depth_blend.psnr_db"] > scores["nearest_view.psnr_db"]
