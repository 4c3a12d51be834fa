"""Where the cameras stand: as the rig file has them, or found from the recording."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from acquisition.durable import write_durably
from acquisition.progress import Progress
from acquisition.recording.reader import Recording
from reconstruction.errors import GeometryError
from reconstruction.initialization.initialisers import InitOptions, initialise
from reconstruction.run.folder import RunFolder
from reconstruction.run.plan import Decision, Plan
from rigs.rig import Rig
from rigs.toml import dump_rig, load_rig

FILE, REFINED = "poses/rig.toml", "poses/refined.toml"
REFINE_SD_DEG = 0.03  # a fifth of a pixel


def poses_stage(run: RunFolder, recording: Recording, progress: Progress) -> None:
    """Find the cameras where the plan says so; what `auto` cannot trust is refused, and the nominal rig kept.

    The held-out camera's spikes are used here, for its own place alone, and `run.json` says so. Raises GeometryError
    where a method that was asked for by name finds no cameras to trust.
    """
    init, holdout = run.plan.init, run.config.holdout
    if init == "sweep":
        progress(1.0, f"poses of rig {recording.rig.name} as given")
        return
    views = [c for c in recording.rig.ids if c in run.plan.views or c == holdout]
    try:
        found = initialise(init, recording, views, InitOptions(run.config.seed, run.config.dust3r_checkpoint), progress)
    except GeometryError as error:
        if run.config.init != "auto":
            raise
        _keep_nominal(run, str(error))
        progress(1.0, f"nominal poses kept: {error}")
        return
    _write(run.path / FILE, found.rig)
    run.document["poses"] = {"init": init, "held_out_used": holdout in views, **found.report}
    reason = str(found.report.get("summary", "the rig's poses are nominal"))
    unsure = float(found.report.get("rotation_sd_deg", 0.0)) > REFINE_SD_DEG  # type: ignore[arg-type]
    plan = run.plan.amended(Decision("poses", f"found by {init}", reason, "--init"))
    if unsure:
        plan = _refining(run, plan, f"they are known to no better than {REFINE_SD_DEG:g} degrees")
    run.document["plan"] = plan.to_json()
    run.save()


def posed(run: RunFolder, recording: Recording, *, refined: bool = False) -> Recording:
    """The recording with the cameras that the poses stage found; as it is where that had nothing to find.

    `refined`: with those that the training made of them, where it did.
    """
    names = (REFINED, FILE) if refined else (FILE,)
    file = next((run.path / name for name in names if (run.path / name).exists()), None)
    if file is None:
        return recording
    pixels = {camera.id: camera.pixels for camera in recording.rig.cameras}
    rig = load_rig(file)
    return replace(recording, rig=replace(rig, cameras=tuple(replace(c, pixels=pixels[c.id]) for c in rig.cameras)))


def write_refined(run: RunFolder, rig: Rig, report: dict) -> None:
    """Keep the cameras that training ended with, and what it changed."""
    _write(run.path / REFINED, rig)
    run.document["refinement"] = report


def _keep_nominal(run: RunFolder, reason: str) -> None:
    run.document["poses"] = {"init": "sweep", "refused": reason, "held_out_used": False}
    plan = run.plan.amended(Decision("poses", "nominal, as given", reason, "--init"), init="sweep")
    plan = _refining(run, plan, "they are nominal")
    run.document["plan"] = plan.to_json()
    run.save()


def _refining(run: RunFolder, plan: Plan, reason: str) -> Plan:
    """The plan with poses refined in training, unless that was forbidden."""
    if run.config.refine == "off":
        return plan
    return plan.amended(Decision("refinement", "poses, gains and lags in training", reason, "--refine"), refine=True)


def _write(path: Path, rig: Rig) -> None:
    """The rig without its files of pixels, which lie beside the recording."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_durably(path, dump_rig(replace(rig, cameras=tuple(replace(c, pixels=None) for c in rig.cameras))))
