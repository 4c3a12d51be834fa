"""Calibration boards: OpenCV reads what was drawn without it, and finds the corners where the truth has them."""

import numpy as np
import pytest

from acquisition.scenes.boards import APRILTAG_36H11, DICT_4X4_50, april_grid, charuco
from acquisition.scenes.catalog import build_scene
from rigs.toml import catalog_rig

cv2 = pytest.importorskip("cv2", reason="needs OpenCV, which the reconstruction extra brings")

FINE = 3  # corners are sought in pictures so many times as fine, for OpenCV's refinement to be exact enough
RIG = catalog_rig("lab3x3").scaled(400 * FINE, 250 * FINE)


@pytest.mark.parametrize(
    ("codes", "family", "side"),
    [(DICT_4X4_50, cv2.aruco.DICT_4X4_50, 4), (APRILTAG_36H11, cv2.aruco.DICT_APRILTAG_36h11, 6)],
)
def test_code_words_are_those_of_the_families(codes, family, side):
    dictionary = cv2.aruco.getPredefinedDictionary(family)
    for number, code in enumerate(codes):
        drawn = dictionary.generateImageMarker(number, side + 2)[1:-1, 1:-1] > 0
        assert int("".join(str(int(bit)) for bit in drawn.ravel()), 2) == code


def picture(name: str, camera_id: str, instant_s: float):
    """The 8-bit view of a board, and where the truth has points [n, 3] in metres from its top left corner."""
    scene, camera = build_scene(name, 0), RIG.camera(camera_id)
    light = scene.render(camera, np.array([instant_s]), 2).intensity[0]
    placed = scene.placements(np.array([instant_s]))

    def seen(points: np.ndarray, size_m: np.ndarray) -> np.ndarray:
        in_camera = camera.cam_from_rig.apply((points - size_m / 2) @ placed.rotations[0, 1].T + placed.positions[0, 1])
        return in_camera[:, :2] / in_camera[:, 2:] * [camera.fx, camera.fy] + [camera.cx, camera.cy]

    return (np.clip(light / scene.white, 0, 1) * 255).astype(np.uint8), seen


@pytest.mark.parametrize(
    ("name", "instant_s", "camera_id"),
    [
        ("board_charuco", 0.0, "cam00"),
        ("board_charuco", 0.0, "cam21"),
        ("board_charuco_moving", 0.0, "cam11"),
        ("board_charuco_moving", 0.11, "cam02"),
    ],
)
def test_charuco_corners_lie_where_the_truth_has_them(name, camera_id, instant_s):
    image, seen = picture(name, camera_id, instant_s)
    board = cv2.aruco.CharucoBoard((6, 4), 0.1, 0.0675, cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50))
    corners, numbers, _, _ = cv2.aruco.CharucoDetector(board).detectBoard(image)
    assert len(numbers) == 15
    points = board.getChessboardCorners()[numbers.ravel()].astype(float)
    off = corners.reshape(-1, 2) + 0.5 - seen(points, np.array([0.6, 0.4, 0]))  # OpenCV's first centre is (0, 0)
    assert np.abs(off).max() < 0.1


@pytest.mark.parametrize(
    ("name", "instant_s", "camera_id"),
    [
        ("board_april", 0.0, "cam00"),
        ("board_april", 0.0, "cam21"),
        ("board_april_moving", 0.0, "cam11"),
        ("board_april_moving", 0.11, "cam02"),
    ],
)
def test_april_tags_lie_where_the_truth_has_them(name, camera_id, instant_s):
    image, seen = picture(name, camera_id, instant_s)
    board, tag, gap = april_grid(), 80, 24
    family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    found, numbers, _ = cv2.aruco.ArucoDetector(family).detectMarkers(image)
    assert sorted(numbers.ravel()) == list(range(12))
    corners = tag * np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    size_m = np.array([board.columns, board.rows, 0]) * board.texel_m
    off = []
    for at, number in zip(found, numbers.ravel(), strict=True):
        texels = corners + gap + np.array([number % 4, number // 4]) * (tag + gap)
        points = np.hstack([texels * board.texel_m, np.zeros((4, 1))])
        cv2.cornerSubPix(image, at, (5, 5), (-1, -1), (3, 100, 1e-4))
        off.append(at.reshape(4, 2) + 0.5 - seen(points, size_m))
    assert np.abs(np.mean(off, axis=1)).max() < 0.1  # the middle of each tag
    assert np.abs(off).max() < 0.13 * FINE  # pixels round a tag's corners, so they are found further in: 0.11 at worst


def test_boards_name_themselves_and_fit_their_texture():
    for board in (charuco(), april_grid()):
        assert board.columns <= board.picture.shape[1]
        assert board.rows <= board.picture.shape[0]
        assert set(np.unique(board.picture)) == {0, 1}
    assert charuco().spec == "charuco:6x4:100:67.5:DICT_4X4_50"
    assert april_grid().spec == "apriltag:4x3:96:28.8:36h11"
