"""The scenes that calibrate: even light and no light for pixels, boards for cameras. Seeds change nothing in them."""

import math

import numpy as np

from acquisition.scenes.boards import Board, april_grid, charuco
from acquisition.scenes.bodies import Body, Finish, Shape, about, at, still
from acquisition.scenes.linkage import Sway
from acquisition.scenes.motion import Motion, Movement
from acquisition.scenes.scene import Scene

FLAT_LEVEL = 0.5  # spikes per tick everywhere in `flat`
SCREEN_Z_M = 3.2
PAPER = (0.04, 0.9)  # albedo of black and white print
HELD = Motion(at(0.0, 0.0, 1.35, about(1, 0.25) @ about(0, -0.15)))
WAVED = Sway(
    at(0.0, 0.0, 1.45),
    reach_m=(0.22, 0.12, 0.2),
    turn_rad=(0.4, 0.45, 0.35),
    rates_rad_s=(2 * math.pi * 2.0, 2 * math.pi * 3.0, 2 * math.pi * 4.0),
    turn_rates_rad_s=(2 * math.pi * 5.0, 2 * math.pi * 3.5, 2 * math.pi * 2.5),
    phases_rad=(0.3, 1.1, 2.0),
)


def flat(seed: int) -> Scene:
    """Build an even field of `FLAT_LEVEL`, as an integrating sphere gives, for the gain of each pixel."""
    return _even_field("flat", seed, FLAT_LEVEL)


def dark(seed: int) -> Scene:
    """Build a scene without light, as behind a lens cap, for the dark current of each pixel."""
    return _even_field("dark", seed, 0.0)


def board_charuco(seed: int) -> Scene:
    """Build a ChArUco board that stands still 1.35 m away."""
    return _board("board_charuco", seed, charuco(), HELD)


def board_charuco_moving(seed: int) -> Scene:
    """Build a ChArUco board that is waved near and far, to all sides and tilts, within half a second."""
    return _board("board_charuco_moving", seed, charuco(), WAVED)


def board_april(seed: int) -> Scene:
    """Build a grid of AprilTags that stands still 1.35 m away."""
    return _board("board_april", seed, april_grid(), HELD)


def board_april_moving(seed: int) -> Scene:
    """Build a grid of AprilTags that is waved like the other board."""
    return _board("board_april_moving", seed, april_grid(), WAVED)


def board_face(board: Board) -> Shape:
    """Return the board as a rectangle about its middle, x along its rows and y down its columns."""
    middle = ((board.columns - 1) / 2, (board.rows - 1) / 2)
    size = (board.columns * board.texel_m / 2, board.rows * board.texel_m / 2)
    return Shape("rectangle", size, Finish(0, board.texel_m, PAPER, middle))


def _board(name: str, seed: int, board: Board, motion: Movement) -> Scene:
    print_on = Body("board", (board_face(board),), motion)
    grey = still("screen", (0.0, 0.0, SCREEN_Z_M), Shape("rectangle", (500.0, 500.0), Finish(1, 1.0, (0.0, 0.4))))
    pictures = np.stack([board.picture, np.full_like(board.picture, 0.5)])
    return Scene(
        name, seed, (grey, print_on), pictures, (0.0, 0.0, 1.45), to_sun=(-0.3, -0.4, -1.0), ambient=0.5, mipmapped=True
    )


def _even_field(name: str, seed: int, level: float) -> Scene:
    """Build nothing but one surface of even light, far wider than any camera's field."""
    finish = Finish(0, 1.0, (1.0, 1.0) if level else (0.0, 0.0))
    screen = still("screen", (0.0, 0.0, SCREEN_Z_M), Shape("rectangle", (500.0, 500.0), finish))
    even = np.ones((1, 4, 4), dtype=np.float32)
    center, to_sun, white = (0.0, 0.0, 1.8), (0.0, 0.0, -1.0), level or FLAT_LEVEL
    return Scene(name, seed, (screen,), even, center, to_sun, white=white, ambient=1.0, background=level)
