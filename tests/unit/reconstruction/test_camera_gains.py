"""Gains and lags of cameras are found where the recording tells them, and left alone where it does not."""

import json
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
import torch

from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.packing import pack
from acquisition.spikes.sensor import Sensor
from acquisition.spikes.stream import SpikeStream
from reconstruction.evaluation.evaluate import HeldOut, gained_by_spikes, score_against_counts
from reconstruction.gaussians.cloud import GaussianCloud
from reconstruction.gaussians.dynamic import DynamicCloud
from reconstruction.gaussians.polynomial import PolynomialMotion
from reconstruction.initialization.gains import Gains, camera_gains
from reconstruction.initialization.sweep import DepthMap
from reconstruction.rendering.render import render
from reconstruction.scene_model import TimeSpan
from reconstruction.training.lags import LEAST_STEPS, LOOKS, Lags
from reconstruction.training.view import TrainingView
from reconstruction.truth import Truth
from rigs.camera import Camera
from rigs.clock import RigClock
from rigs.rig import Rig
from rigs.transform import Transform

WIDTH, HEIGHT, FOCAL, DEPTH_M, VIEWS = 80, 60, 80.0, 2.0, 4
PLANES, CLOCK = 200, RigClock(20_000.0)


def cameras(count: int = VIEWS) -> list[Camera]:
    """Cameras side by side, 5 cm apart, which is two pixels at DEPTH_M."""
    places = [np.array([0.05 * i, 0.0, 0.0]) for i in range(count)]
    lens = (WIDTH, HEIGHT, FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2)
    return [Camera(f"cam0{i}", *lens, Transform(np.eye(3), -place)) for i, place in enumerate(places)]


def pictures(gains: list[float], noise: float = 0.0) -> tuple[list[DepthMap], list[np.ndarray], list[np.ndarray]]:
    """A rough wall at DEPTH_M as the cameras have it, with its depth."""
    rng = np.random.default_rng(4)
    wall = cv2.GaussianBlur(rng.uniform(0.1, 0.7, (HEIGHT, 3 * WIDTH)).astype(np.float32), (0, 0), 1.0)
    maps, images = [], []
    for i, (camera, gain) in enumerate(zip(cameras(len(gains)), gains, strict=True)):
        seen = wall[:, 2 * i + 40 : 2 * i + 40 + WIDTH] * gain
        images.append((seen * (1 + noise * rng.standard_normal(seen.shape))).astype(np.float32))
        maps.append(DepthMap(camera, np.full((HEIGHT, WIDTH), DEPTH_M, np.float32), np.zeros((HEIGHT, WIDTH), "f4")))
    return maps, images, [np.ones((HEIGHT, WIDTH), bool)] * len(gains)


def test_gains_are_found_to_a_tenth_of_a_percent():
    true = [1.0, 1.07, 0.9, 1.02]
    found = camera_gains(*pictures(true, 0.03))
    logs = np.log(true) - np.log(true).mean()
    assert found.determined
    assert np.abs(found.logs - logs).max() < 3e-3
    assert found.logs.mean() == pytest.approx(0, abs=1e-12)
    assert (np.abs(found.logs - logs) < 4 * found.sds).all()


def test_cameras_that_are_alike_are_left_alone():
    found = camera_gains(*pictures([1.0] * 4, 0.03))
    assert not found.determined
    assert found.spread < 3e-3


@pytest.mark.parametrize("case", ["no depth", "all moves", "dark", "one view sees nothing"])
def test_where_nothing_tells_there_is_no_gain(case):
    maps, images, still = pictures([1.0, 1.1, 0.9, 1.0])
    nowhere = np.full((HEIGHT, WIDTH), np.nan, np.float32)
    if case == "no depth":
        maps = [replace(m, depth=nowhere) for m in maps]
    elif case == "all moves":
        still = [np.zeros_like(s) for s in still]
    elif case == "dark":
        images = [image * 0 for image in images]
    else:
        maps = [replace(maps[0], depth=nowhere), *maps[1:]]
    found = camera_gains(maps, images, still)
    assert not np.isfinite(found.sds).any()
    assert not found.determined
    assert (found.logs == 0).all()


@pytest.mark.parametrize("gain", [0.0, np.inf])
def test_a_camera_that_sees_nothing_or_everything_spoils_no_other(gain):
    maps, images, still = pictures([1.0, 1.1, 0.9, 1.0])
    images[0] = np.full_like(images[0], gain)
    with np.errstate(invalid="ignore"):
        found = camera_gains(maps, images, still)
    assert not found.determined
    assert np.isfinite(found.logs).all()


def test_one_odd_pair_widens_the_doubt():
    exact = Gains(np.array([0.01, -0.01]), np.array([1e-3, 1e-3]))
    assert exact.determined
    assert not Gains(exact.logs, np.array([5e-3, 5e-3])).determined
    assert not Gains(exact.logs, np.array([np.inf, 1e-3])).determined


def scene() -> DynamicCloud:
    """A bright wall, and blobs that cross 60 cm a clip before it."""
    rng = np.random.default_rng(0)
    wall = np.column_stack([rng.uniform(-2, 2, 400), rng.uniform(-1.5, 1.5, 400), np.full(400, DEPTH_M)])
    still = GaussianCloud.from_points(
        torch.tensor(wall, dtype=torch.float32), torch.full((400, 1), 0.5), torch.full((400,), 0.15).log(), 0.9
    )
    at = torch.tensor([[0.0, -0.1, 1.5], [0.1, 0.2, 1.5], [0.2, 0.0, 1.4]])
    moving = GaussianCloud.from_points(at, torch.full((3, 1), 0.1), torch.full((3,), 0.06).log(), 0.95)
    motion = PolynomialMotion.at_rest(torch.full((3,), 0.5), 100.0)
    motion.velocities[:, 0] = 1.5
    return DynamicCloud(still, moving, motion, TimeSpan(0.0, PLANES / CLOCK.tick_rate_hz))


def lagging(cloud: DynamicCloud, lags: list[float], noise: float = 0.0) -> list[TrainingView]:
    """Views whose images are those of an instant later."""

    def view(camera: Camera, lag: float) -> TrainingView:
        def at(plane: int) -> np.ndarray:
            with torch.no_grad():
                light = render(cloud.at(CLOCK.instant_s(plane + lag)), camera).intensity[..., 0].numpy()
            return light + noise * np.random.default_rng(plane).standard_normal(light.shape).astype(np.float32)

        source: Any = SimpleNamespace(at=at, stream=range(PLANES), moving=np.ones((HEIGHT, WIDTH), bool))
        source.useless = lambda last: np.zeros((HEIGHT, WIDTH), bool)
        return TrainingView(camera, source)

    return [view(camera, lag) for camera, lag in zip(cameras(len(lags)), lags, strict=True)]


def looked(cloud: DynamicCloud, views: list[TrainingView], steps: int = LEAST_STEPS) -> Lags:
    found = Lags(len(views), CLOCK)
    seen = [replace(v, corrected=lambda c, instant_s, i=i: found.seen(c, instant_s, i)) for i, v in enumerate(views)]
    for done in (0.0, *LOOKS, 0.99):
        found.look(cloud, seen, done, steps)
    return found


def test_lags_are_found_from_what_moves():
    true = np.array([0.6, -1.0, 3.0, 0.2])
    cloud = scene()
    found = looked(cloud, lagging(cloud, true.tolist(), 0.01))
    np.testing.assert_allclose(found.ticks, true - true.mean(), atol=0.1)
    assert found.looks == len(LOOKS)
    again = Lags(4, CLOCK)
    again.restore(json.loads(json.dumps(found.state())))
    np.testing.assert_array_equal(again.ticks, found.ticks)


def test_cameras_in_step_are_left_alone_and_looked_at_once():
    cloud = scene()
    found = looked(cloud, lagging(cloud, [0.0, 0.05, -0.05, 0.0], 0.01))
    assert (found.ticks == 0).all()
    assert (found.looks, found.ended) == (1, True)


def test_a_short_training_does_not_look():
    cloud = scene()
    found = looked(cloud, lagging(cloud, [3.0, -3.0, 0.0, 0.0], 0.01), LEAST_STEPS - 1)
    assert (found.ticks == 0).all()
    assert (found.looks, found.ended) == (0, True)


def test_where_nothing_moves_no_lag_is_told():
    cloud = scene()
    cloud.motion.velocities[:] = 0
    found = looked(cloud, lagging(cloud, [3.0, -3.0, 0.0, 0.0], 0.01))
    assert (found.ticks == 0).all()


def test_the_truth_takes_the_light_and_clock_of_those_that_trained(tmp_path):
    own = {"cam00": {"gain": 0.5, "lag_ticks": 1.0}, "cam01": {"gain": 2.0, "lag_ticks": 3.0}}
    own |= {"cam11": {"gain": 7.0, "lag_ticks": 70.0}}
    truth = Truth(tmp_path, 0.6, ())
    assert truth.seen_by(["cam00"]) is truth  # none is known to differ
    (tmp_path / "own.json").write_text(json.dumps(own))
    assert truth.seen_by(["cam00", "cam77"]) is truth
    seen = truth.seen_by(["cam00", "cam01"])
    assert (seen.gain, seen.lag_ticks, seen.white) == (pytest.approx(1.0), 2.0, pytest.approx(0.6))
    (tmp_path / "cam11").mkdir()
    for prefix in ("", "depth_", "id_"):
        np.save(tmp_path / f"cam11/{prefix}000000.npy", np.full((2, 3), 0.3, np.float32))
    dim = truth.seen_by(["cam00"])
    np.testing.assert_allclose(dim.frame("cam11", 0).intensity, 0.15)
    assert dim.white == pytest.approx(0.3)


@pytest.mark.parametrize("gain", [0.7, 1.0, 1.3])
def test_without_truth_odd_windows_tell_the_gain_of_the_held_out_camera(gain):
    cloud, camera = scene(), cameras(1)[0]
    cloud.motion.velocities[:] = 0
    with torch.no_grad():
        light = render(cloud.at(CLOCK.instant_s(100)), camera).intensity[..., 0].numpy()
    planes = Sensor(WIDTH, HEIGHT, "ideal", 1, 0).expose(np.repeat(light[None] * np.float32(gain), PLANES, axis=0))
    layout = PlaneLayout(WIDTH, HEIGHT)
    rig = Rig("one", CLOCK.tick_rate_hz, (camera,))
    recording: Any = SimpleNamespace(rig=rig, stream=lambda _: SpikeStream(pack(planes, layout), layout, 2e4))
    before = HeldOut(camera, recording)
    found = gained_by_spikes(cloud, before)
    assert found.gain == pytest.approx(gain, rel=0.015)  # counts of 32 planes round
    errors = [score_against_counts(cloud, held_out)["counts.mae"] for held_out in (before, found)]
    assert errors[1] < 0.5
    assert gain == 1 or errors[1] < 0.3 * errors[0]
    assert found.windows()[1] == [0, 64, 128]  # and is scored on the others
