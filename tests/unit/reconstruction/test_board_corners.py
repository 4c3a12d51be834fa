"""Points of boards in pictures of simulated boards, against where the truth projects them."""

import functools
import itertools

import cv2
import numpy as np
import pytest

from acquisition.scenes.catalog import build_scene
from reconstruction.calibration.board_corners import find_board, find_tags, without_defects
from reconstruction.calibration.board_sightings import chosen_planes
from reconstruction.calibration.board_spec import parse_board
from rigs.toml import catalog_rig

RIG = catalog_rig("lab3x3")
CHARUCO = parse_board("charuco:6x4:100:67.5:DICT_4X4_50")
APRIL = parse_board("apriltag:4x3:96:28.8:36h11")
MIDDLES = {CHARUCO: (0.3, 0.2, 0), APRIL: (0.2352, 0.1728, 0)}  # of the scenes' boards, from the first point's origin
VIEWS = [
    ("board_charuco", CHARUCO, 0.0, "cam00"),
    ("board_charuco_moving", CHARUCO, 0.11, "cam11"),
    ("board_april", APRIL, 0.0, "cam22"),
    ("board_april_moving", APRIL, 0.11, "cam02"),
]


@functools.cache
def view(scene_name, camera_id, instant_s):
    scene = build_scene(scene_name, 0)
    return scene.render(RIG.camera(camera_id), np.array([instant_s]), 4).intensity[0].astype(np.float32)


def truth(scene_name, board, camera_id, instant_s):
    camera, placed = RIG.camera(camera_id), build_scene(scene_name, 0).placements(np.array([instant_s]))
    in_rig = (board.points - MIDDLES[board]) @ placed.rotations[0, 1].T + placed.positions[0, 1]
    seen = camera.cam_from_rig.apply(in_rig)
    return seen[:, :2] / seen[:, 2:] * [camera.fx, camera.fy] + [camera.cx, camera.cy]


@pytest.mark.parametrize(("name", "board", "instant_s", "camera_id"), VIEWS)
def test_points_lie_where_the_truth_has_them(name, board, instant_s, camera_id):
    found = find_board(view(name, camera_id, instant_s), board)
    np.testing.assert_array_equal(found.points, np.arange(len(board.points)))
    off = found.pixels - truth(name, board, camera_id, instant_s)
    assert np.sqrt((off**2).mean()) < 0.015  # 0.004 to 0.010
    assert np.abs(off.mean(axis=0)).max() < 0.003


@pytest.mark.parametrize(("name", "board", "instant_s", "camera_id"), VIEWS)
def test_hot_and_dead_pixels_hardly_move_them(name, board, instant_s, camera_id):
    image, rng = view(name, camera_id, instant_s).copy(), np.random.default_rng(0)
    image[rng.integers(0, 250, 60), rng.integers(0, 400, 60)] = rng.choice([0.0, 1.0], 60)
    found = find_board(image, board)
    off = found.pixels - truth(name, board, camera_id, instant_s)[found.points]
    assert len(found.points) >= 0.9 * len(board.points)
    assert np.sqrt((off**2).mean()) < 0.03


def test_blur_along_a_motion_does_not_shift_them():
    name, board, camera_id = "board_charuco_moving", CHARUCO, "cam11"
    instants_s = 0.11 + np.arange(-8, 9) / 20000
    frames = build_scene(name, 0).render(RIG.camera(camera_id), instants_s, 2).intensity
    found = find_board(frames.mean(axis=0).astype(np.float32), board)
    off = found.pixels - truth(name, board, camera_id, 0.11)[found.points]
    assert np.sqrt((off**2).mean()) < 0.02


def test_what_is_covered_is_left_out():
    image = view("board_charuco", "cam11", 0.0).copy()
    seen = truth("board_charuco", CHARUCO, "cam11", 0.0)
    image[:, : int(seen[:, 0].mean())] = 0.3
    found = find_board(image, CHARUCO)
    assert 4 <= len(found.points) < 15
    assert found.pixels[:, 0].min() > seen[:, 0].mean()
    assert np.abs(found.pixels - seen[found.points]).max() < 0.05


def test_another_board_is_not_taken_for_it():
    image = view("board_charuco", "cam11", 0.0)
    assert not len(find_board(image, APRIL).points)
    turned = find_board(image, parse_board("charuco:4x6:100:67.5:DICT_4X4_50"))
    assert turned.fitting < 0.5 * len(turned.tags)
    assert not len(find_board(np.zeros((250, 400), np.float32), CHARUCO).points)
    noise = np.random.default_rng(1).random((250, 400)).astype(np.float32)
    assert not len(find_board(noise, CHARUCO).points)


def test_a_mirrored_board_is_not_found():
    image = np.ascontiguousarray(view("board_charuco", "cam11", 0.0)[:, ::-1])
    assert not len(find_board(image, CHARUCO).points)


def test_tags_of_a_larger_picture_are_the_same():
    image = view("board_april", "cam11", 0.0)
    ids, quads = find_tags(image, APRIL.dictionary)
    large = cv2.resize(image, None, fx=4, fy=4, interpolation=cv2.INTER_CUBIC)
    again, fourfold = find_tags(large, APRIL.dictionary)
    np.testing.assert_array_equal(ids, np.arange(12))
    np.testing.assert_array_equal(again, ids)
    assert np.abs(fourfold / 4 - quads).max() < 1.0


def test_single_pixels_out_of_range_are_mended_and_edges_kept():
    image = np.zeros((9, 9), np.float32)
    image[:, 5:] = 1
    spoilt = image.copy()
    spoilt[4, 1], spoilt[4, 7] = 0.8, 0.0
    np.testing.assert_array_equal(without_defects(spoilt), image)


def test_windows_of_the_chosen_planes_do_not_overlap():
    for planes, most in ((5, 60), (17, 60), (400, 60), (6000, 60), (6000, 7)):
        chosen = chosen_planes(planes, most)
        assert len(chosen) == max(min(most, planes // 17), 1)
        assert min(chosen) >= 0
        assert max(chosen) < planes
        assert all(b - a >= 17 for a, b in itertools.pairwise(chosen))
