"""SPECs of calibration boards: the layouts are OpenCV's, and what is wrong is named."""

import cv2
import numpy as np
import pytest

from reconstruction.calibration.board_spec import parse_board, predefined
from reconstruction.errors import BadRunError


def test_a_charuco_board_is_laid_out_as_opencv_does():
    board = parse_board("charuco:7x5:40:27:DICT_5X5_100")
    theirs = cv2.aruco.CharucoBoard((7, 5), 0.04, 0.027, predefined("DICT_5X5_100"))
    np.testing.assert_allclose(board.tags, theirs.getObjPoints(), atol=1e-7)
    np.testing.assert_allclose(board.points, theirs.getChessboardCorners(), atol=1e-7)
    assert board.points.shape == (24, 3)
    for point, tags in zip(board.points, board.tags_of, strict=True):
        apart = np.linalg.norm(board.tags.mean(axis=1) - point, axis=1)
        assert set(tags) == set(np.flatnonzero(apart < 0.04))
    assert board.margin_m == pytest.approx(0.0065)


def test_a_grid_of_tags_is_laid_out_as_opencv_does():
    board = parse_board("apriltag:4x3:96:28.8:36h11")
    theirs = cv2.aruco.GridBoard((4, 3), 0.096, 0.0288, predefined("DICT_APRILTAG_36h11"))
    np.testing.assert_allclose(board.tags, theirs.getObjPoints(), atol=1e-7)
    assert board.dictionary == "DICT_APRILTAG_36h11"
    np.testing.assert_allclose(board.points[5], [0.1728, 0.1728, 0], atol=1e-12)  # its middle
    assert board.points.shape == (12, 3)


@pytest.mark.parametrize(
    ("spec", "named"),
    [
        ("", "expected charuco:COLSxROWS"),
        ("chess:6x4:100:67.5:DICT_4X4_50", "expected charuco:COLSxROWS"),
        ("charuco:6x4:100:67.5", "expected charuco:COLSxROWS"),
        ("charuco:6:100:67.5:DICT_4X4_50", "the size '6'"),
        ("charuco:0x4:100:67.5:DICT_4X4_50", "the size '0x4'"),
        ("charuco:2x4:100:67.5:DICT_4X4_50", "2x4 squares"),
        ("charuco:6x4:0:67.5:DICT_4X4_50", "the square '0'"),
        ("charuco:6x4:100:inf:DICT_4X4_50", "the marker 'inf'"),
        ("charuco:6x4:100:nan:DICT_4X4_50", "the marker 'nan'"),
        ("charuco:6x4:67.5:100:DICT_4X4_50", "the square comes first"),
        ("charuco:6x4:100:67.5:DICT_9X9_50", "'DICT_9X9_50', expected one of DICT_4X4_100"),
        ("charuco:20x20:100:67.5:DICT_4X4_50", "200 tags, expected at most the 50"),
        ("apriltag:4x3:-96:28.8:36h11", "the tag '-96'"),
        ("apriltag:4x3:96:x:36h11", "the gap 'x'"),
        ("apriltag:4x3:96:28.8:41h12", "'41h12', expected one of 16h5, 25h9, 36h10, 36h11"),
        ("apriltag:40x30:96:28.8:36h11", "1200 tags"),
        ("apriltag:4x1:96:28.8:36h11", "4x1 tags, expected at least 2x2"),
    ],
)
def test_what_is_wrong_with_a_spec_is_named(spec, named):
    with pytest.raises(BadRunError) as caught:
        parse_board(spec)
    assert named in str(caught.value)
    assert "\n" not in str(caught.value)
