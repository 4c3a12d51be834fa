"""Simulates the recordings of the defects bench: a scene, seen by cameras with one defect or several."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from acquisition.devices.open import Simulation
from acquisition.durable import made_aside, write_durably
from acquisition.recording.reader import Recording
from acquisition.scenes.truth import EVERY
from acquisition.session.record import simulate
from reconstruction.bench.conventions import apart, truth_of
from reconstruction.images.pixels import estimate_pixels, write_pixels
from rigs.rig import Rig
from rigs.toml import dump_rig

TICKS, CALIBRATION_TICKS = 400, 1000  # planes at the rig's own rate
BARREL = (-0.22, 0.0, 0.0, 0.0)  # ten percent at the corners of the lab rig's pictures


@dataclass(frozen=True)
class Defect:
    """One thing that is wrong with a recording: `simulated` are fields of Simulation that differ from the clean one.

    `bent`: lenses bend as BARREL says. `rate_hz`: planes a second. `maps`: flat and dark recordings of the same sensors
    calibrate the pixels. Without the cure a run has the choices `uncured`, and takes bent lenses for pinholes. `told`:
    the recording is that of another defect, with a rig file that has the cameras as they were built. Costs are counted
    from the recording of the same scene that is named `against`. `seeds` are those of its trainings.
    """

    name: str
    simulated: dict[str, Any] = field(default_factory=dict)
    bent: bool = False
    rate_hz: float | None = None
    maps: bool = False
    uncured: dict[str, Any] = field(default_factory=dict)
    told: Defect | None = None
    against: str = "clean"
    seeds: tuple[int, ...] = (0,)

    @property
    def curable(self) -> bool:
        """A flag: the engine has a cure that can be switched off.

        A bent lens of a nominal rig has none: the search for poses finds it, whether the file tells it or not.
        """
        return bool(self.uncured) or (self.bent and "rig_error" not in self.simulated)


def recorded(work: Path, rig: Rig, subject: tuple[str, int], defect: Defect) -> Path:
    """Return the recording of a scene and seed with a defect in `work`, simulated by `rig` where there is none.

    Truth stands at the same instants at every rate, to half a plane.
    """
    if defect.told:
        return as_built(recorded(work, rig, subject, defect.told))
    scene, seed = subject
    path = work / f"{scene}-{seed}-{defect.name}"
    if not path.exists():
        seen = _seen_by(work, rig, seed, defect)
        ticks = round(TICKS * seen.tick_rate_hz / rig.tick_rate_hz)
        every = max(1, round(EVERY * seen.tick_rate_hz / rig.tick_rate_hz))
        simulation = Simulation(scene, seed, truth_every=every, **defect.simulated)
        with made_aside(path) as aside:
            apart(partial(simulate, simulation, seen, ticks, aside))
    return path


def _seen_by(work: Path, rig: Rig, seed: int, defect: Defect) -> Rig:
    """Return the rig file of the recording: its lenses, its rate, and its calibrated pixels."""
    rig = replace(rig, tick_rate_hz=defect.rate_hz or rig.tick_rate_hz)
    if defect.bent:
        rig = replace(rig, cameras=tuple(replace(c, distortion=BARREL) for c in rig.cameras))
    if not defect.maps:
        return rig
    simulated = {name: value for name, value in defect.simulated.items() if name in ("traits", "sensor", "glass")}
    flat, dark = (
        _even(work / f"{light}-{seed}-{defect.name}", Simulation(light, seed, **simulated), rig)
        for light in ("flat", "dark")
    )
    cameras = []
    for camera in rig.cameras:
        file = work / f"{defect.name}-{seed}-{camera.id}.npz"
        write_pixels(file, estimate_pixels(flat.stream(camera.id), dark.stream(camera.id)))
        cameras.append(replace(camera, pixels=file))
    return replace(rig, cameras=tuple(cameras))


def _even(path: Path, simulation: Simulation, rig: Rig) -> Recording:
    """Return a recording of even light or of none."""
    if not path.exists():
        with made_aside(path) as aside:
            apart(partial(simulate, simulation, rig, CALIBRATION_TICKS, aside))
    return Recording.open(path)


def straightened(path: Path) -> Path:
    """Return the same recording with a rig file that knows of no bent lens."""
    rig = Recording.open(path).rig
    pinholes = tuple(replace(c, distortion=(0.0,) * 4, pixels=None) for c in rig.cameras)
    return _with_rig(path, "straight", replace(rig, cameras=pinholes))


def as_built(path: Path) -> Path:
    """Return the same recording with a rig file that has the true poses and focal lengths."""
    recording = Recording.open(path)
    true = truth_of(recording).cameras(recording.tick_rate_hz)
    if true is None:
        return path
    pairs = [(camera, true.camera(camera.id)) for camera in recording.rig.cameras]
    built = tuple(replace(c, cam_from_rig=t.cam_from_rig, fx=t.fx, fy=t.fy) for c, t in pairs)
    return _with_rig(path, "built", replace(recording.rig, cameras=built, poses="calibrated"))


def _with_rig(path: Path, name: str, rig: Rig) -> Path:
    """Return the recording at `path` with another rig file, in a folder of the same name and `name`."""
    out = path.with_name(f"{path.name}-{name}")
    if not out.exists():
        with made_aside(out) as aside:
            aside.mkdir(parents=True, exist_ok=True)
            for file in path.iterdir():
                if file.name != "rig.toml":
                    (aside / file.name).symlink_to(file.resolve())
            write_durably(aside / "rig.toml", dump_rig(rig))
    return out
