"""Similarities between rigs, and small turns."""

from dataclasses import replace

import numpy as np
import pytest

from rigs.errors import RigError
from rigs.rig import object_distance_m
from rigs.similarity import Similarity, align
from rigs.toml import catalog_rig
from rigs.transform import Transform, cross_matrices, rotations, rotvec_of

RIG = catalog_rig("lab3x3")


def carried(scale=1.7):
    turn = Transform.from_rotvec((0.3, -0.5, 0.2))
    return Similarity(scale, turn.rotation, np.array([1.0, -2.0, 0.5]))


def test_alignment_finds_the_similarity_again():
    similarity = carried()
    found = align(RIG, similarity.carry_rig(RIG))
    assert found.scale == pytest.approx(1.7, rel=1e-12)
    np.testing.assert_allclose(found.rotation, similarity.rotation, atol=1e-12)
    np.testing.assert_allclose(found.translation, similarity.translation, atol=1e-12)


def test_a_carried_camera_sees_carried_points_where_it_saw_them():
    similarity, camera = carried(), RIG.cameras[0]
    points = np.random.default_rng(0).uniform((-0.3, -0.3, 1.7), (0.3, 0.3, 2.3), (20, 3))
    before = camera.cam_from_rig.apply(points)
    after = similarity.carry(camera.cam_from_rig).apply(similarity.apply(points))
    np.testing.assert_allclose(after, 1.7 * before, atol=1e-12)


@pytest.mark.parametrize("ids", [("cam00",), ("cam00", "cam01"), ("cam10", "cam11", "cam12")])
def test_few_cameras_or_cameras_in_a_line_still_fix_the_turn(ids):
    similarity = carried(1.0)
    found = align(RIG.only(ids), similarity.carry_rig(RIG))
    np.testing.assert_allclose(found.rotation, similarity.rotation, atol=1e-12)
    assert found.scale == pytest.approx(1.0)


def test_rigs_without_a_common_camera_are_refused():
    other = replace(RIG, cameras=(replace(RIG.cameras[0], id="cam77"),))
    with pytest.raises(RigError, match="expected the same ids"):
        align(RIG, other)


def test_the_same_rig_needs_no_carrying():
    moved = align(RIG, RIG).carry_rig(RIG)
    for one, other in zip(RIG.cameras, moved.cameras, strict=True):
        np.testing.assert_allclose(one.cam_from_rig.matrix, other.cam_from_rig.matrix, atol=1e-12)


@pytest.mark.parametrize("length", [0.0, 1e-300, 1e-9, 1e-3, 1.0, 3.0, np.pi - 1e-6])
def test_rotation_vectors_round_trip(length):
    vector = length * np.array([2.0, -1.0, 2.0]) / 3
    rotation = rotations(vector)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(rotvec_of(rotation), vector, rtol=1e-6, atol=1e-15)


def test_cross_matrices_multiply_as_the_cross_product():
    rng = np.random.default_rng(1)
    a, b = rng.normal(size=(5, 3)), rng.normal(size=(5, 3))
    np.testing.assert_allclose((cross_matrices(a) @ b[:, :, None])[:, :, 0], np.cross(a, b), atol=1e-14)


def test_the_object_is_where_the_axes_meet():
    assert object_distance_m(RIG.cameras) == pytest.approx(1.8, abs=0.1)
    parallel = tuple(replace(c, cam_from_rig=Transform(np.eye(3), c.cam_from_rig.translation)) for c in RIG.cameras)
    centers = np.array([c.center for c in parallel])
    baseline = np.linalg.norm(centers - centers.mean(axis=0), axis=1).mean()
    assert object_distance_m(parallel) == pytest.approx(10 * baseline)
