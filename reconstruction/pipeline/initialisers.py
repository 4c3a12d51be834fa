"""The initialisers by the name an operator gives: each finds the cameras of a recording, and what it sees on the way.

They are imported when they are called: some need torch, some pycolmap, and most runs need neither.
"""

from __future__ import annotations

import datetime
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from acquisition.progress import Progress, silent
from acquisition.recording.reader import Recording
from reconstruction.errors import BadRunError, GeometryError
from reconstruction.initialization.geometry import Geometry

MSDI_SHARE = 0.7  # of the time that MSDI with bundle adjustment takes


@dataclass(frozen=True)
class InitOptions:
    """`seed` of all draws; `checkpoint`: the user's DUSt3R weights."""

    seed: int = 0
    checkpoint: str | None = None


Initialiser = Callable[[Recording, Sequence[str], InitOptions, Progress], Geometry]


def initialise(
    name: str, recording: Recording, views: Sequence[str], options: InitOptions, progress: Progress = silent
) -> Geometry:
    """The geometry that `views` of a recording show, by the initialiser `name`.

    Raises BadRunError for an unknown name, GeometryError where the cameras found cannot be trusted.
    """
    if name not in INITIALISERS:
        raise BadRunError(f"found the initialiser {name!r}", f"one of {', '.join(INITIALISERS)}")
    return INITIALISERS[name](recording, views, options, progress)


def long_images(recording: Recording, views: Sequence[str]) -> dict[str, NDArray[np.float32]]:
    """The long-window image of every view."""
    from reconstruction.calibration.features import long_image

    return {view: long_image(recording.stream(view)) for view in views}


def _natural(recording: Recording, views: Sequence[str], options: InitOptions, progress: Progress) -> Geometry:
    from reconstruction.calibration.natural import NaturalOptions, calibrate_natural

    images, today = long_images(recording, views), datetime.date.today().isoformat()
    found = calibrate_natural(recording.rig, images, today, NaturalOptions(seed=options.seed), progress)
    return Geometry(found.rig, report=found.report)


def _sfm(recording: Recording, views: Sequence[str], options: InitOptions, progress: Progress) -> Geometry:
    from reconstruction.initialization.sfm import sfm

    return sfm(recording.rig, long_images(recording, views), progress=progress)


def _dust3r(recording: Recording, views: Sequence[str], options: InitOptions, progress: Progress) -> Geometry:
    from reconstruction.initialization.dust3r.initialiser import dust3r

    checkpoint = Path(options.checkpoint) if options.checkpoint else None
    return dust3r(recording.rig, long_images(recording, views), checkpoint, progress=progress)


def _msdi(recording: Recording, views: Sequence[str], options: InitOptions, progress: Progress) -> Geometry:
    """MSDI at the middle of the recording, then bundle adjustment from where it leaves the cameras."""
    from reconstruction.calibration.natural import AFTER_MSDI, calibrate_natural

    found = msdi_alone(recording, views, lambda f, m: progress(MSDI_SHARE * f, m))
    begun = replace(recording, rig=found.rig)
    today = datetime.date.today().isoformat()
    fine = calibrate_natural(
        begun.rig,
        long_images(recording, views),
        today,
        replace(AFTER_MSDI, seed=options.seed),
        lambda f, m: progress(MSDI_SHARE + (1 - MSDI_SHARE) * f, m),
    )
    return Geometry(fine.rig, found.points, found.confidence, found.images, {**fine.report, "msdi": found.report})


def msdi_alone(recording: Recording, views: Sequence[str], progress: Progress = silent) -> Geometry:
    """What MSDI's network alone finds at the middle of the recording; raises GeometryError where it is refused."""
    from reconstruction.initialization.msdi import initialise as look

    middle = recording.rig.clock.instant_s(recording.planes // 2)
    found = look({view: recording.stream(view) for view in views}, recording.rig, middle, progress)
    if "refused" in found.report:
        raise GeometryError(f"msdi: {found.report['refused']}")
    return found


INITIALISERS: dict[str, Initialiser] = {"natural": _natural, "sfm": _sfm, "dust3r": _dust3r, "msdi": _msdi}
