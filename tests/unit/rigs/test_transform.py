import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from rigs.errors import RigError
from rigs.transform import Transform

numbers = st.floats(-10, 10)
vectors = arrays(np.float64, 3, elements=numbers)
quats = arrays(np.float64, 4, elements=st.floats(-1, 1)).filter(lambda q: np.linalg.norm(q) > 1e-3)
transforms = st.builds(Transform.from_quat_wxyz, quats, vectors)


def assert_same(a: Transform, b: Transform, atol: float = 1e-12) -> None:
    np.testing.assert_allclose(a.matrix, b.matrix, rtol=0, atol=atol)


@given(transforms, transforms, transforms)
def test_composition_is_associative(a, b, c):
    assert_same((a @ b) @ c, a @ (b @ c))


@given(transforms)
def test_inverse_cancels_on_both_sides(t):
    assert_same(t @ t.inverse(), Transform.identity())
    assert_same(t.inverse() @ t, Transform.identity())


@given(transforms, transforms, arrays(np.float64, (4, 3), elements=numbers))
def test_composed_transform_applies_the_right_one_first(a, b, points):
    np.testing.assert_allclose((a @ b).apply(points), a.apply(b.apply(points)), rtol=0, atol=1e-12)


@given(transforms)
def test_center_lands_on_the_target_origin(t):
    np.testing.assert_allclose(t.apply(t.center), 0, atol=1e-12)


@given(transforms)
def test_quaternion_round_trip(t):
    quat = t.quat_wxyz
    assert abs(np.linalg.norm(quat) - 1) < 1e-12
    assert quat[0] >= 0
    assert_same(Transform.from_quat_wxyz(quat, t.translation), t)


@given(
    arrays(np.float64, 3, elements=st.floats(-1, 1)).filter(lambda a: np.linalg.norm(a) > 1e-2), st.floats(-1e-7, 1e-7)
)
def test_quaternion_round_trip_at_and_near_half_turns(axis, off):
    axis = axis / np.linalg.norm(axis)
    angle = math.pi + off
    t = Transform.from_quat_wxyz([math.cos(angle / 2), *(math.sin(angle / 2) * axis)], np.zeros(3))
    np.testing.assert_allclose(t.rotation @ axis, axis, atol=1e-12)
    assert_same(Transform.from_quat_wxyz(t.quat_wxyz, np.zeros(3)), t)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_half_turn_about_an_axis_negates_the_other_two(axis):
    diagonal = -np.ones(3)
    diagonal[axis] = 1
    t = Transform(np.diag(diagonal), np.zeros(3))
    want = np.zeros(4)
    want[1 + axis] = 1
    np.testing.assert_array_equal(np.abs(t.quat_wxyz), want)


def test_quarter_turn_about_z_by_hand():
    t = Transform.from_quat_wxyz([math.sqrt(0.5), 0, 0, math.sqrt(0.5)], [1, 2, 3])
    np.testing.assert_allclose(t.apply([1, 0, 0]), [1, 3, 3], atol=1e-15)


@given(vectors, vectors)
def test_looking_at_puts_the_target_on_the_axis_ahead(center, target):
    distance = np.linalg.norm(target - center)
    sideways = np.linalg.norm(np.cross([0, 1, 0], target - center))
    if sideways < 1e-3 * max(distance, 1):
        return
    t = Transform.looking_at(center, target)
    np.testing.assert_allclose(t.apply(target), [0, 0, distance], atol=1e-9)
    np.testing.assert_allclose(t.center, center, atol=1e-12)
    assert t.rotation[0, 1] == pytest.approx(0, abs=1e-12)  # the picture's rows stay level
    assert t.rotation[1, 1] > 0  # and down stays down


def test_looking_along_its_own_vertical_is_refused():
    with pytest.raises(RigError, match="vertical"):
        Transform.looking_at((0, 0, 0), (0, 1, 0))


@pytest.mark.parametrize(
    ("rotation", "translation", "word"),
    [
        (np.full((3, 3), np.nan), np.zeros(3), "NaN"),
        (np.eye(3), [0, np.inf, 0], "NaN or infinity"),
        (np.diag([1.0, 1.0, -1.0]), np.zeros(3), "not a rotation"),
        (2 * np.eye(3), np.zeros(3), "not a rotation"),
        (np.eye(2), np.zeros(3), "shapes"),
    ],
)
def test_what_is_no_pose_is_refused(rotation, translation, word):
    with pytest.raises(RigError, match=word):
        Transform(rotation, translation)


@pytest.mark.parametrize("quat", [[0, 0, 0, 0], [1, 0, 0], [np.nan, 0, 0, 1]])
def test_what_is_no_quaternion_is_refused(quat):
    with pytest.raises(RigError, match="quaternion"):
        Transform.from_quat_wxyz(quat, np.zeros(3))
