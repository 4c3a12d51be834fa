"""The methods of the pose bench: spikes of some views and a nominal rig in, geometry out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from acquisition.recording.reader import Recording
from acquisition.scenes.boards import charuco
from reconstruction.calibration.board_spec import parse_board
from reconstruction.calibration.boards import calibrate_board
from reconstruction.calibration.features import MOST_PLANES, long_image
from reconstruction.calibration.natural import calibrate_natural
from reconstruction.images.methods.msdi import msdi
from reconstruction.images.methods.tfi import tfi
from reconstruction.initialization.geometry import Geometry
from reconstruction.initialization.initialisers import InitOptions, initialise, msdi_alone
from reconstruction.initialization.sfm import sfm
from rigs.rig import Rig

DATE = "2026-01-01"  # of the rigs found, which nobody keeps
Images = dict[str, NDArray[np.float32]]
Run = Callable[[Recording, Rig, Sequence[str], int | None], Geometry]


@dataclass(frozen=True)
class PoseMethod:
    """`run` takes a recording, the nominal rig, the views' ids and how many planes there are (None: all)."""

    name: str
    about: str
    run: Run


def _nominal(recording: Recording, rig: Rig, views: Sequence[str], planes: int | None) -> Geometry:
    return Geometry(rig)


def _natural(recording: Recording, rig: Rig, views: Sequence[str], planes: int | None) -> Geometry:
    found = calibrate_natural(rig, _long(recording, views, planes), DATE)
    return Geometry(found.rig, report=found.report)


def _tfi_colmap(recording: Recording, rig: Rig, views: Sequence[str], planes: int | None) -> Geometry:
    middle = recording.planes // 2
    return sfm(rig, {view: tfi(recording.stream(view), middle).intensity for view in views})


def _long_colmap(recording: Recording, rig: Rig, views: Sequence[str], planes: int | None) -> Geometry:
    return sfm(rig, _long(recording, views, planes))


def _long(recording: Recording, views: Sequence[str], planes: int | None) -> Images:
    return {view: long_image(recording.stream(view), planes or MOST_PLANES) for view in views}


def _msdi(recording: Recording, rig: Rig, views: Sequence[str], planes: int | None) -> Geometry:
    return msdi_alone(replace(recording, rig=rig), views)


def _msdi_ba(recording: Recording, rig: Rig, views: Sequence[str], planes: int | None) -> Geometry:
    return initialise("msdi", replace(recording, rig=rig), views, InitOptions())


def _msdi_colmap(recording: Recording, rig: Rig, views: Sequence[str], planes: int | None) -> Geometry:
    middle = recording.planes // 2
    return sfm(rig, {view: msdi(recording.stream(view), middle).intensity for view in views})


def _board(recording: Recording, rig: Rig, views: Sequence[str], planes: int | None) -> Geometry:
    found = calibrate_board(replace(recording, rig=rig), parse_board(charuco().spec), DATE)
    return Geometry(found.rig, report=found.report)


BOARD_SCENE, BOARD_TICKS = "board_charuco_moving", 2000
BOARD = PoseMethod("board", f"a ChArUco board waved for {BOARD_TICKS} planes", _board)
METHODS = {
    method.name: method
    for method in (
        PoseMethod("nominal", "the rig as drawn", _nominal),
        PoseMethod("tfi+colmap", "TFI images of one instant, COLMAP from scratch", _tfi_colmap),
        PoseMethod("msdi-image+colmap", "MSDI images of one instant, COLMAP from scratch", _msdi_colmap),
        PoseMethod("long+colmap", "long-window images, COLMAP from scratch", _long_colmap),
        PoseMethod("natural", "natural-scene calibration from the nominal rig", _natural),
        PoseMethod("msdi", "MSDI's network alone, at one instant", _msdi),
        PoseMethod("msdi+ba", "MSDI, then natural calibration from its cameras", _msdi_ba),
    )
}
