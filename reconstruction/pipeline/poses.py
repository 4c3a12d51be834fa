"""Where the cameras stand: as the rig file has them, or found from the recording."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from acquisition.durable import write_durably
from acquisition.progress import Progress
from acquisition.recording.reader import Recording
from reconstruction.errors import GeometryError
from reconstruction.initialization.geometry import Geometry
from reconstruction.training.plan import Decision
from reconstruction.training.run import RunFolder
from rigs.rig import Rig
from rigs.toml import dump_rig, load_rig

FILE = "poses/rig.toml"
Initialiser = Callable[[RunFolder, Recording, Sequence[str], Progress], Geometry]


def poses_stage(run: RunFolder, recording: Recording, progress: Progress) -> None:
    """Find the cameras where the plan says so; what `auto` cannot trust is refused, and the nominal rig kept.

    The held-out camera's spikes are used here, for its own place alone, and `run.json` says so. Raises GeometryError
    where a method that was asked for by name finds no cameras to trust.
    """
    init, holdout = run.plan.init, run.config.holdout
    if init not in INITIALISERS:
        progress(1.0, f"poses of rig {recording.rig.name} as given")
        return
    views = [c for c in recording.rig.ids if c in run.plan.views or c == holdout]
    try:
        found = INITIALISERS[init](run, recording, views, progress)
    except GeometryError as error:
        if run.config.init != "auto":
            raise
        _keep_nominal(run, str(error))
        progress(1.0, f"nominal poses kept: {error}")
        return
    _write(run.path / FILE, found.rig)
    run.document["poses"] = {"init": init, "held_out_used": holdout in views, **found.report}
    reason = str(found.report.get("summary", "the rig's poses are nominal"))
    plan = run.plan.amended(Decision("poses", f"found by {init}", reason, "--init"))
    run.document["plan"] = plan.to_json()
    run.save()


def posed(run: RunFolder, recording: Recording) -> Recording:
    """The recording with the cameras that the poses stage found; as it is where that had nothing to find."""
    if not (run.path / FILE).exists():
        return recording
    pixels = {camera.id: camera.pixels for camera in recording.rig.cameras}
    rig = load_rig(run.path / FILE)
    return replace(recording, rig=replace(rig, cameras=tuple(replace(c, pixels=pixels[c.id]) for c in rig.cameras)))


def _keep_nominal(run: RunFolder, reason: str) -> None:
    run.document["poses"] = {"init": "sweep", "refused": reason, "held_out_used": False}
    plan = run.plan.amended(Decision("poses", "nominal, as given", reason, "--init"), init="sweep")
    run.document["plan"] = plan.to_json()
    run.save()


def _write(path: Path, rig: Rig) -> None:
    """The rig without its files of pixels, which lie beside the recording."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_durably(path, dump_rig(replace(rig, cameras=tuple(replace(c, pixels=None) for c in rig.cameras))))


def _natural(run: RunFolder, recording: Recording, views: Sequence[str], progress: Progress) -> Geometry:
    from reconstruction.calibration.features import long_image
    from reconstruction.calibration.natural import NaturalOptions, calibrate_natural

    images = {view: long_image(recording.stream(view)) for view in views}
    found = calibrate_natural(recording.rig, images, NaturalOptions(seed=run.config.seed), progress)
    return Geometry(found.rig, report=found.report)


INITIALISERS: dict[str, Initialiser] = {"natural": _natural}
