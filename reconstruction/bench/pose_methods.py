"""Lists the methods of the pose bench: each finds geometry from a recording whose rig is the nominal one."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from acquisition.recording.reader import Recording
from acquisition.scenes.boards import charuco
from acquisition.spikes.stream import SpikeStream
from reconstruction.calibration.board_spec import parse_board
from reconstruction.calibration.boards import calibrate_board
from reconstruction.calibration.features import MOST_PLANES, long_image
from reconstruction.calibration.natural import calibrate_natural
from reconstruction.images.methods.msdi import msdi
from reconstruction.images.methods.tfi import tfi
from reconstruction.initialization.geometry import Geometry
from reconstruction.initialization.initialisers import InitOptions, initialise, msdi_alone
from reconstruction.initialization.sfm import sfm

DATE = "2026-01-01"  # date written into the rigs found, which nobody keeps
BOARD_SCENE, BOARD_TICKS = "board_charuco_moving", 2000
Images = dict[str, NDArray[np.float32]]
Run = Callable[[Recording, Sequence[str], int | None], Geometry]


@dataclass(frozen=True)
class PoseMethod:
    """A way to find cameras: `run` takes a recording with the nominal rig, the views' ids, and planes (None: all)."""

    name: str
    about: str
    run: Run


def _long(recording: Recording, views: Sequence[str], planes: int | None) -> Images:
    return {view: long_image(recording.stream(view), planes or MOST_PLANES) for view in views}


def _colmap(intensity: Callable[[SpikeStream, int], NDArray[np.float32]]) -> Run:
    """Return COLMAP from scratch on images of the middle of the clip."""
    return lambda recording, views, _: sfm(
        recording.rig, {view: intensity(recording.stream(view), recording.planes // 2) for view in views}
    )


def _natural(recording: Recording, views: Sequence[str], planes: int | None) -> Geometry:
    found = calibrate_natural(recording.rig, _long(recording, views, planes), DATE)
    return Geometry(found.rig, report=found.report)


def _board(recording: Recording, views: Sequence[str], planes: int | None) -> Geometry:
    found = calibrate_board(recording, parse_board(charuco().spec), DATE)
    return Geometry(found.rig, report=found.report)


BOARD = PoseMethod("board", f"a ChArUco board waved for {BOARD_TICKS} planes", _board)
METHODS = {
    method.name: method
    for method in (
        PoseMethod("nominal", "the rig as drawn", lambda recording, *_: Geometry(recording.rig)),
        PoseMethod(
            "tfi+colmap", "TFI images of one instant, COLMAP from scratch", _colmap(lambda s, k: tfi(s, k).intensity)
        ),
        PoseMethod(
            "msdi-image+colmap",
            "MSDI images of one instant, COLMAP from scratch",
            _colmap(lambda s, k: msdi(s, k).intensity),
        ),
        PoseMethod(
            "long+colmap", "long-window images, COLMAP from scratch", lambda r, v, n: sfm(r.rig, _long(r, v, n))
        ),
        PoseMethod("natural", "natural-scene calibration from the nominal rig", _natural),
        PoseMethod("msdi", "MSDI's network alone, at one instant", lambda r, v, _: msdi_alone(r, v)),
        PoseMethod(
            "msdi+ba",
            "MSDI, then natural calibration from its cameras",
            lambda r, v, _: initialise("msdi", r, v, InitOptions()),
        ),
    )
}
