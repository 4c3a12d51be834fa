"""Lists the methods of the pose bench: each finds geometry from a recording whose rig is the nominal one.

A method takes the recording, the views' ids, and the number of planes to look at (None: all).
"""

from collections.abc import Callable, Sequence

from acquisition.progress import silent
from acquisition.recording.reader import Recording
from acquisition.scenes.boards import charuco
from reconstruction.calibration.board_spec import parse_board
from reconstruction.calibration.boards import calibrate_board
from reconstruction.images.catalogue import method
from reconstruction.initialization.geometry import Geometry
from reconstruction.initialization.initialisers import INITIALISERS, InitOptions, msdi_alone
from reconstruction.initialization.sfm import sfm

DATE = "2026-01-01"  # date written into the rigs found, which nobody keeps
BOARD = "board"  # the method that sees another recording
BOARD_SCENE, BOARD_TICKS = "board_charuco_moving", 2000
Run = Callable[[Recording, Sequence[str], int | None], Geometry]


def _colmap(name: str) -> Run:
    """Return COLMAP from scratch on the images of the middle of the clip by the method `name`."""
    return lambda recording, views, _: sfm(
        recording.rig, {view: method(name)(recording.stream(view), recording.planes // 2).intensity for view in views}
    )


def _by(name: str) -> Run:
    """Return one of the initialisers that a run may choose."""
    return lambda recording, views, planes: INITIALISERS[name](recording, views, InitOptions(planes=planes), silent)


def _board(recording: Recording, views: Sequence[str], planes: int | None) -> Geometry:
    found = calibrate_board(recording, parse_board(charuco().spec), DATE)
    return Geometry(found.rig, report=found.report)


METHODS: dict[str, Run] = {
    "nominal": _by("sweep"),
    "tfi+colmap": _colmap("tfi"),
    "msdi-image+colmap": _colmap("msdi"),
    "long+colmap": _by("sfm"),
    "natural": _by("natural"),
    "msdi": lambda recording, views, _: msdi_alone(recording, views),
    "msdi+ba": _by("msdi"),
    BOARD: _board,
}
