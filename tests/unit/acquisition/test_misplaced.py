"""Rigs that were not built as drawn."""

from dataclasses import replace

import numpy as np
import pytest

from acquisition.devices.open import Simulation, parse_devices
from acquisition.devices.usb import CameraSetupError
from acquisition.scenes.misplaced import misplaced
from rigs.rig import Calibration
from rigs.toml import catalog_rig
from rigs.transform import rotvec_of

RIG = catalog_rig("lab3x3")


def off(rig):
    turns = [
        np.degrees(np.linalg.norm(rotvec_of(a.cam_from_rig.rotation @ b.cam_from_rig.rotation.T)))
        for a, b in zip(rig.cameras, RIG.cameras, strict=True)
    ]
    shifts = [100 * np.linalg.norm(a.center - b.center) for a, b in zip(rig.cameras, RIG.cameras, strict=True)]
    return np.mean(turns), np.mean(shifts)


def test_errors_are_as_large_as_said_on_average():
    found = np.array([off(misplaced(RIG, 2.0, seed)) for seed in range(40)])
    np.testing.assert_allclose(found.mean(axis=0), 2.0, rtol=0.1)


def test_all_lenses_share_one_error_of_the_focal_length():
    factors = {round(a.fx / b.fx, 12) for a, b in zip(misplaced(RIG, 2.0, 1).cameras, RIG.cameras, strict=True)}
    assert factors in ({1.02}, {0.98})


def test_turns_may_have_another_size():
    turn, shift = np.mean([off(misplaced(RIG, 1.0, seed, turn_deg=4.0)) for seed in range(40)], axis=0)
    assert turn == pytest.approx(4.0, rel=0.1)
    assert shift == pytest.approx(1.0, rel=0.1)


def test_the_same_seed_misplaces_alike_and_none_leaves_the_poses():
    one, other = misplaced(RIG, 2.0, 3), misplaced(RIG, 2.0, 3)
    assert all(
        (a.cam_from_rig.matrix == b.cam_from_rig.matrix).all() for a, b in zip(one.cameras, other.cameras, strict=True)
    )
    assert off(misplaced(RIG, 0.0, 3)) == pytest.approx((0, 0), abs=1e-9)
    assert one.poses == "nominal"


def test_simulated_cameras_stand_elsewhere_than_the_recording_says():
    simulation = parse_devices("mock:fan_and_ball?rig_error=1.5&seed=2")
    assert isinstance(simulation, Simulation)
    assert off(simulation.built(RIG))[0] == pytest.approx(1.5, rel=0.6)
    assert simulation.drawn(RIG).poses == "nominal"
    exact = Simulation("fan_and_ball")
    assert exact.built(RIG) is RIG
    assert exact.drawn(RIG) is RIG


@pytest.mark.parametrize("value", ["-1", "21", "x", "1e1", "", "nan", "٣"])
def test_an_error_that_is_no_number_is_refused(value):
    with pytest.raises(CameraSetupError, match=r"rig.error"):
        parse_devices(f"mock:fan_and_ball?rig_error={value}")


def test_a_calibration_does_not_move_simulated_cameras():
    drawing = catalog_rig("lab3x3")
    simulation = Simulation("fan_and_ball", seed=3, rig_error=2.0)
    built = simulation.built(drawing)
    measured = replace(built, poses="calibrated", calibration=Calibration("2026-11-21", 0.1, 0.01))
    for one, other in zip(simulation.built(measured).cameras, built.cameras, strict=True):
        np.testing.assert_array_equal(one.cam_from_rig.matrix, other.cam_from_rig.matrix)
        assert (one.fx, one.serial) == (other.fx, other.serial)
    assert simulation.drawn(measured) is measured
    assert simulation.drawn(drawing).poses == "nominal"
    own = replace(measured, name="own")
    assert simulation.built(own) is own
