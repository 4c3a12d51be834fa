"""The print of a calibration board: its tags, their ids, and the places of their corners in metres.

SPEC is `charuco:COLSxROWS:SQUARE_MM:MARKER_MM:DICT` (squares, the first one black) or
`apriltag:COLSxROWS:TAG_MM:GAP_MM:36h11` (tags, id 0 at the top left, row by row). A board's frame has its origin at the
top left corner, of the first square or of the first tag, x along the rows, y down the columns and z into the board.
"""

import math
import re
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np

from reconstruction.errors import BadRunError
from rigs.transform import Floats

FORMS = "charuco:COLSxROWS:SQUARE_MM:MARKER_MM:DICT or apriltag:COLSxROWS:TAG_MM:GAP_MM:36h11"
DICTIONARIES = tuple(sorted(name for name in dir(cv2.aruco) if re.fullmatch(r"DICT_(?!.*\dH\d)\w+", name)))
_APRILTAG = "DICT_APRILTAG_"
_FAMILIES = {name.removeprefix(_APRILTAG): name for name in DICTIONARIES if name.startswith(_APRILTAG)}
_MOST = 100  # squares or tags a side


@dataclass(frozen=True, eq=False)
class BoardSpec:
    """A board: T tags of `dictionary`, their corners [T, 4, 3] in metres clockwise from the top left, and N points.

    The points [N, 3] in metres are what is measured: the inner corners of a ChArUco board's squares, row by row, or the
    middles of the tags. Print and light that spread move a tag's corners outward, but not its middle. `tags_of` [N, 2]
    are the two tags next to each point, equal where it has one. `margin_m`
    is how far from a point the next print begins.
    """

    text: str
    kind: Literal["charuco", "apriltag"]
    dictionary: str
    tags: Floats
    points: Floats
    tags_of: np.ndarray
    margin_m: float


def parse_board(text: str) -> BoardSpec:
    """Return the board that SPEC describes; raises BadRunError naming the part that is wrong."""
    parts = text.strip().split(":")
    if len(parts) != 5 or parts[0] not in ("charuco", "apriltag"):
        raise BadRunError(f"found the board {text!r}", FORMS)
    try:
        return (_charuco if parts[0] == "charuco" else _april_grid)(text, *_grid(parts[1]), parts[2:])
    except BadRunError as error:
        raise BadRunError.at(f"board {text}", error) from None


def predefined(name: str) -> cv2.aruco.Dictionary:
    """Return OpenCV's dictionary of that name."""
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


def _charuco(text: str, columns: int, rows: int, parts: list[str]) -> BoardSpec:
    square, marker = _metres("square", parts[0]), _metres("marker", parts[1])
    if columns < 3 or rows < 3:
        raise BadRunError(f"found {columns}x{rows} squares", "at least 3x3")
    if marker >= square:
        found = f"found markers of {1000.0 * marker:g} mm in squares of {1000.0 * square:g} mm"
        raise BadRunError(found, "smaller markers", "the square comes first")
    dictionary = _dictionary(parts[2], columns * rows // 2)
    white = [(row, column) for row in range(rows) for column in range(columns) if (row + column) % 2]
    tags = _tags(square * np.array(white)[:, ::-1] + (square - marker) / 2, marker)
    points = square * np.array([(x, y, 0) for y in range(1, rows) for x in range(1, columns)], dtype=np.float64)
    distances = np.linalg.norm(tags.mean(axis=1)[None] - points[:, None], axis=2)
    tags_of = np.sort(np.argsort(distances, axis=1)[:, :2], axis=1)
    return BoardSpec(text, "charuco", dictionary, tags, points, tags_of, (square - marker) / 2)


def _april_grid(text: str, columns: int, rows: int, parts: list[str]) -> BoardSpec:
    tag, gap = _metres("tag", parts[0]), _metres("gap", parts[1])
    if parts[2] not in _FAMILIES:
        raise BadRunError(f"found the family {parts[2]!r}", f"one of {', '.join(_FAMILIES)}")
    if columns < 2 or rows < 2:
        raise BadRunError(f"found {columns}x{rows} tags", "at least 2x2")
    dictionary = _dictionary(_FAMILIES[parts[2]], columns * rows)
    at = (tag + gap) * np.array([(column, row) for row in range(rows) for column in range(columns)], dtype=np.float64)
    tags = _tags(at, tag)
    tags_of = np.repeat(np.arange(columns * rows)[:, None], 2, axis=1)
    return BoardSpec(text, "apriltag", dictionary, tags, tags.mean(axis=1), tags_of, gap)


def _tags(at: Floats, side: float) -> Floats:
    """Return the corners [T, 4, 3] of square tags whose top left corners lie at [T, 2], all in m."""
    corners = at[:, None] + side * np.array([(0, 0), (1, 0), (1, 1), (0, 1)])
    return np.concatenate([corners, np.zeros((*corners.shape[:2], 1))], axis=2)


def _dictionary(name: str, tags: int) -> str:
    if name not in DICTIONARIES:
        raise BadRunError(f"found the dictionary {name!r}", f"one of {', '.join(DICTIONARIES)}")
    size = len(predefined(name).bytesList)
    if tags > size:
        raise BadRunError(f"found {tags} tags", f"at most the {size} of {name}")
    return name


def _grid(part: str) -> tuple[int, int]:
    match = re.fullmatch(r"(\d{1,4})x(\d{1,4})", part)
    if not match or not all(1 <= int(n) <= _MOST for n in match.groups()):
        raise BadRunError(f"found the size {part!r}", f"COLSxROWS of 1 to {_MOST}, such as 6x4")
    return int(match[1]), int(match[2])


def _metres(name: str, part: str) -> float:
    try:
        millimetres = float(part)
    except ValueError:
        millimetres = math.nan
    if not 0 < millimetres < 1e5:
        raise BadRunError(f"found the {name} {part!r}", "a positive number of millimetres")
    return millimetres / 1e3
