"""The initialisers that `--init` names: each finds the cameras of a recording, and what it sees on the way.

What does the work is imported when it is called: some need torch, some pycolmap, and most runs need neither.
"""

import datetime
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

from acquisition.progress import Progress, part, silent
from acquisition.recording.reader import Recording
from reconstruction.initialization.geometry import Geometry, Images

MSDI_SHARE = 0.7  # share of MSDI itself in the time that MSDI with bundle adjustment takes


@dataclass(frozen=True)
class InitOptions:
    """`seed` of all draws; `checkpoint`: the user's DUSt3R weights; `planes` to look at in a long image at most."""

    seed: int = 0
    checkpoint: str | None = None
    planes: int | None = None


# Returns the geometry that `views` of a recording show; no other view is read. Raises GeometryError where the cameras
# found cannot be trusted.
Initialiser = Callable[[Recording, Sequence[str], InitOptions, Progress], Geometry]


def msdi_alone(recording: Recording, views: Sequence[str], progress: Progress = silent) -> Geometry:
    """Return what MSDI's network alone finds at the middle of the recording; raises GeometryError where it refuses."""
    from reconstruction.initialization.msdi import initialise as look

    middle = recording.rig.clock.instant_s(recording.planes // 2)
    return look({view: recording.stream(view) for view in views}, recording.rig, middle, progress)


def _sweep(recording: Recording, views: Sequence[str], options: InitOptions, progress: Progress) -> Geometry:
    """Leave the cameras where the recording's rig has them; points come from a plane sweep in every run."""
    progress(1.0, f"poses of rig {recording.rig.name} as given")
    return Geometry(recording.rig)


def _natural(recording: Recording, views: Sequence[str], options: InitOptions, progress: Progress) -> Geometry:
    from reconstruction.calibration.moments import movers_of
    from reconstruction.calibration.natural import calibrate_natural

    images, today = _long_images(recording, views, options), datetime.date.today().isoformat()
    movers = movers_of(recording, views)
    found = calibrate_natural(recording.rig, images, today, progress, seed=options.seed, movers=movers)
    return Geometry(found.rig, report=found.report)


def _sfm(recording: Recording, views: Sequence[str], options: InitOptions, progress: Progress) -> Geometry:
    from reconstruction.initialization.sfm import sfm

    return sfm(recording.rig, _long_images(recording, views, options), progress=progress)


def _dust3r(recording: Recording, views: Sequence[str], options: InitOptions, progress: Progress) -> Geometry:
    from reconstruction.initialization.dust3r.initialiser import dust3r

    checkpoint = Path(options.checkpoint) if options.checkpoint else None
    return dust3r(recording.rig, _long_images(recording, views, options), checkpoint, progress=progress)


def _msdi(recording: Recording, views: Sequence[str], options: InitOptions, progress: Progress) -> Geometry:
    """Find the cameras by MSDI, then adjust them by the bundle from where it leaves them."""
    from reconstruction.calibration.moments import movers_of
    from reconstruction.calibration.natural import AFTER_MSDI, calibrate_natural

    found = msdi_alone(recording, views, part(progress, 0, MSDI_SHARE))
    images, today = _long_images(recording, views, options), datetime.date.today().isoformat()
    rest = part(progress, MSDI_SHARE, 1)
    movers = movers_of(recording, views)
    fine = calibrate_natural(found.rig, images, today, rest, gate=AFTER_MSDI, seed=options.seed, movers=movers)
    return replace(found, rig=fine.rig, report={**fine.report, "msdi": found.report})


def _long_images(recording: Recording, views: Sequence[str], options: InitOptions) -> Images:
    from reconstruction.calibration.features import MOST_PLANES, long_images

    return long_images(recording, views, options.planes or MOST_PLANES)


INITIALISERS: Mapping[str, Initialiser] = MappingProxyType(
    {"sweep": _sweep, "natural": _natural, "sfm": _sfm, "dust3r": _dust3r, "msdi": _msdi}
)
FINDING_POINTS = ("sfm", "dust3r", "msdi")  # those that find points beside cameras
