"""Draws calibration boards without OpenCV: a ChArUco board and a grid of AprilTags.

The code words are facts of the two families: the first of OpenCV's DICT_4X4_50 and of AprilTag 36h11 (Olson,
"AprilTag: a robust and flexible visual fiducial system", ICRA 2011), a 1 a white cell, row by row from the top left.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from acquisition.scenes import natural

# fmt: off
DICT_4X4_50 = (0xB532, 0x0F9A, 0x332D, 0x9946, 0x549E, 0x79CD, 0x9E2E, 0xC4F2, 0xFEDA, 0xCF56, 0xF991, 0x11A7)
APRILTAG_36H11 = (0x21A146BAB, 0x92D18FE9B, 0x7089014BB, 0x193979E27, 0x44153D3D7, 0x35CD5B8CF, 0xA10BA56A0,
                  0x2B874A608, 0xB57FB8D44, 0x4E20B5A64, 0x61D897F2C, 0xAB3469FFC)
# fmt: on


@dataclass(frozen=True, eq=False)
class Board:
    """A board in the top left `columns` x `rows` texels of `picture` [S, S] of 0 and 1, each `texel_m` wide.

    `spec` is its name for `calibrate --board`.
    """

    spec: str
    picture: NDArray[np.float32]
    columns: int
    rows: int
    texel_m: float


def charuco() -> Board:
    """Draw 6 x 4 squares of 100 mm, the first one black, with markers of 67.5 mm in the white ones."""
    square, inset, texel_m = 80, 13, 0.1 / 80
    picture = np.zeros((natural.SIZE, natural.SIZE), dtype=np.float32)
    codes = iter(DICT_4X4_50)
    for row in range(4):
        for column in range(6):
            if (row + column) % 2:
                y, x = row * square, column * square
                picture[y : y + square, x : x + square] = 1
                tag = _tag(next(codes), 4, cell=9)
                picture[y + inset : y + inset + len(tag), x + inset : x + inset + len(tag)] = tag
    return Board("charuco:6x4:100:67.5:DICT_4X4_50", picture, 6 * square, 4 * square, texel_m)


def april_grid() -> Board:
    """Draw 4 x 3 tags of 96 mm, 28.8 mm apart, without the black squares where the corners of four tags meet."""
    tag, gap, texel_m = 80, 24, 0.096 / 80
    picture = np.ones((natural.SIZE, natural.SIZE), dtype=np.float32)
    for n, code in enumerate(APRILTAG_36H11):
        y, x = gap + n // 4 * (tag + gap), gap + n % 4 * (tag + gap)
        picture[y : y + tag, x : x + tag] = _tag(code, 6, cell=10)
    return Board("apriltag:4x3:96:28.8:36h11", picture, 4 * (tag + gap) + gap, 3 * (tag + gap) + gap, texel_m)


def _tag(code: int, side: int, cell: int) -> NDArray[np.float32]:
    """Draw a tag of `side` x `side` cells in a black border of one cell, `cell` texels each."""
    bits = [code >> (side * side - 1 - i) & 1 for i in range(side * side)]
    cells = np.pad(np.array(bits, dtype=np.float32).reshape(side, side), 1)
    return cells.repeat(cell, axis=0).repeat(cell, axis=1)
