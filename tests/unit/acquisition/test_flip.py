"""Cameras that were read upside down are suspected from their own geometry; others are not."""

import dataclasses

import numpy as np
import pytest

from acquisition.recording.flip import suspected_flip
from acquisition.scenes.catalog import build_scene
from acquisition.spikes.sensor import Sensor
from rigs.rig import Rig
from rigs.toml import catalog_rig


def means_of(rig: Rig, scene: str, seed: int) -> dict[str, np.ndarray]:
    """Mean images of 32 planes by real sensors."""
    found = {}
    for number, camera in enumerate(rig.cameras):
        light = build_scene(scene, seed).render(camera, np.zeros(1), 2).intensity
        sensor = Sensor(camera.width, camera.height, "real", seed, number)
        found[camera.id] = sensor.expose(np.repeat(light, 32, axis=0)).mean(axis=0)
    return found


def upside_down(means: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {camera_id: image[::-1] for camera_id, image in means.items()}


@pytest.mark.parametrize(("name", "size"), [("lab3x3", (100, 64)), ("ci3x3", (60, 40))])
@pytest.mark.parametrize("seed", [0, 1])
def test_a_rig_read_upside_down_is_suspected(name, size, seed):
    """Measured: 0.61 to 0.71 as it is and 0.37 to 0.46 upside down."""
    rig = catalog_rig(name).scaled(*size)
    means = means_of(rig, "fan_and_ball", seed)
    assert suspected_flip(rig, means) is None
    assert "rows reversed; import with the other --row-order" in (suspected_flip(rig, upside_down(means)) or "")


def test_poses_that_are_a_little_off_do_no_harm():
    rig = catalog_rig("lab3x3").scaled(100, 64)
    means = means_of(rig, "fan_and_ball", 2)
    rng = np.random.default_rng(0)
    cameras = []
    for camera in rig.cameras:
        shift = rng.normal(0, 0.005, 3)
        moved = dataclasses.replace(camera.cam_from_rig, translation=camera.cam_from_rig.translation + shift)
        cameras.append(dataclasses.replace(camera, cam_from_rig=moved))
    rough = dataclasses.replace(rig, cameras=tuple(cameras))
    assert suspected_flip(rough, means) is None
    assert suspected_flip(rough, upside_down(means))


def test_what_tells_nothing_is_not_suspected():
    rig = catalog_rig("lab3x3").scaled(60, 40)
    for means in (
        means_of(rig, "flat", 0),
        means_of(rig, "dark", 0),
        {camera_id: np.random.default_rng(n).random((40, 60)) for n, camera_id in enumerate(rig.ids)},
        {camera_id: np.zeros((40, 60)) for camera_id in rig.ids},
    ):
        assert suspected_flip(rig, means) is None
    seen = means_of(rig, "fan_and_ball", 0)
    for few in (["cam11"], ["cam00", "cam10"]):
        assert suspected_flip(rig.only(few), upside_down(seen)) is None
    one_place = dataclasses.replace(
        rig, cameras=tuple(dataclasses.replace(rig.cameras[0], id=c, serial="") for c in rig.ids)
    )
    assert suspected_flip(one_place, seen) is None


def test_pictures_too_small_for_a_window_tell_nothing():
    rig = catalog_rig("lab3x3").scaled(8, 5)
    assert suspected_flip(rig, {camera_id: np.random.default_rng(0).random((5, 8)) for camera_id in rig.ids}) is None
