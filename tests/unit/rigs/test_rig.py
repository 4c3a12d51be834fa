from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rigs.camera import Camera
from rigs.clock import RigClock
from rigs.errors import RigError
from rigs.rig import Rig
from rigs.transform import Transform


def camera(camera_id: str = "cam00", **changes) -> Camera:
    values = {"width": 40, "height": 25, "fx": 35.0, "fy": 36.0, "cx": 20.0, "cy": 12.5}
    return Camera(id=camera_id, cam_from_rig=Transform.identity(), **values | changes)


@given(st.integers(1, 200), st.integers(1, 200), st.floats(-1, 1), st.floats(-1, 1))
def test_scaled_camera_sees_a_point_at_the_same_place_of_the_picture(width, height, x, y):
    large, small = camera(), camera().scaled(width, height)
    u = large.K @ [x, y, 1] / [large.width, large.height, 1]
    v = small.K @ [x, y, 1] / [width, height, 1]
    np.testing.assert_allclose(u, v, atol=1e-12)


@pytest.mark.parametrize(
    "changes", [{"fx": 0.0}, {"fy": -1.0}, {"cx": float("nan")}, {"width": 0}, {"distortion": (0, 0, float("inf"), 0)}]
)
def test_bad_intrinsics_are_refused_naming_the_camera(changes):
    with pytest.raises(RigError, match="cam12"):
        camera("cam12", **changes)


@pytest.mark.parametrize("camera_id", ["", "../cam00", "cam 0", "cam\n00"])
def test_an_id_that_cannot_name_a_file_is_refused(camera_id):
    with pytest.raises(RigError, match="camera id"):
        camera(camera_id)


@given(st.integers(0, 10**9), st.sampled_from([1.0, 3000.0, 20000.0, 40000.0, 1e6 / 3]))
def test_an_instant_lies_in_the_plane_it_came_from(plane, rate):
    clock = RigClock(rate)
    assert clock.plane(clock.instant_s(plane)) == plane


def test_plane_boundaries_by_hand():
    clock = RigClock(20000)
    assert clock.instant_s(100) == pytest.approx(100.5 / 20000)
    assert [clock.plane(t / 20000) for t in (0, 0.99, 1, 1.5)] == [0, 0, 1, 1]


@pytest.mark.parametrize("rate", [0, -1, float("nan"), float("inf")])
def test_a_rate_that_is_none_is_refused(rate):
    with pytest.raises(RigError, match="tick rate"):
        RigClock(rate)


def test_rig_finds_picks_and_scales_its_cameras():
    rig = Rig("pair", 20000, (camera("cam00"), camera("cam01")))
    assert rig.camera("cam01").id == "cam01"
    assert rig.only(["cam01"]).ids == ("cam01",)
    assert {(c.width, c.height) for c in rig.scaled(8, 5).cameras} == {(8, 5)}
    with pytest.raises(RigError, match=r"cam07.*cam00, cam01"):
        rig.camera("cam07")


def test_rigs_that_are_none_are_refused():
    rig = Rig("pair", 20000, (camera("cam00"), camera("cam01")))
    with pytest.raises(RigError, match="no cameras"):
        replace(rig, cameras=())
    with pytest.raises(RigError, match="cam00"):
        replace(rig, cameras=(camera("cam00"), camera("cam00")))
    with pytest.raises(RigError, match="'guessed'"):
        replace(rig, poses="guessed")
