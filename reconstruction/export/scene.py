"""Describes an export: the scene that it reads, the choices of an operator, its format; it needs no torch."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from acquisition.progress import Progress
from acquisition.recording.reader import ticks_between
from reconstruction.errors import BadRunError
from rigs.camera import Camera
from rigs.rig import Rig

if TYPE_CHECKING:
    from reconstruction.gaussians.dynamic import DynamicCloud
    from reconstruction.images.composite import CompositeSource
    from reconstruction.scene_model import SceneModel, TimeSpan
    from reconstruction.uncertainty.expected_error import Uncertainty

FRAMES = 30
TICKS = "from_tick", "to_tick"  # choices of every format over time


@dataclass(frozen=True)
class Choices:
    """The choices of an operator; None is the default.

    `at_s`: seconds on the rig clock. `frames`: how many. `camera`: its id. `from_tick`, `to_tick`: the ticks [from, to)
    of the rig clock that a format over time covers.
    """

    at_s: float | None = None
    frames: int | None = None
    camera: str | None = None
    from_tick: int | None = None
    to_tick: int | None = None


@dataclass(frozen=True, eq=False)
class Scene:
    """A trained run. `targets()` reads the target images of the training views, by camera id.

    `part`: the time that is written, None for all that the model covers. `uncertainty`: what tells its expected errors,
    where the run has the evidence.
    """

    cloud: SceneModel
    rig: Rig
    white: float  # spikes per tick
    model: str  # as `--model` names it
    holdout: str | None
    targets: Callable[[], Mapping[str, CompositeSource]]
    part: TimeSpan | None = None
    uncertainty: Uncertainty | None = None

    @property
    def clip(self) -> TimeSpan:
        """The time that is written."""
        return self.part or self.cloud.clip

    def chosen(self, choices: Choices) -> Scene:
        """Return the scene over the ticks chosen; raises BadRecordingError for ticks that it does not cover."""
        if choices.from_tick is choices.to_tick is None:
            return self
        from reconstruction.scene_model import TimeSpan

        rate_hz, clip = self.rig.tick_rate_hz, self.cloud.clip
        known = range(round(clip.first_s * rate_hz), round(clip.last_s * rate_hz))
        ticks = ticks_between(known, choices.from_tick, choices.to_tick)
        return replace(self, part=TimeSpan(ticks.start / rate_hz, ticks.stop / rate_hz))

    def gaussians_at(self, instant_s: float) -> DynamicCloud:
        """Return the Gaussians of the span that an instant lies in; raises BadRunError if the model has none."""
        from reconstruction.gaussians.dynamic import DynamicCloud
        from reconstruction.gaussians.spanned import SpannedScene

        if isinstance(self.cloud, SpannedScene):
            return self.cloud.part(self.cloud.number_at(instant_s))
        if not isinstance(self.cloud, DynamicCloud):
            raise BadRunError(f"found the model {self.model}, a radiance field", "Gaussians", "export video or depth")
        return self.cloud

    def instant_s(self, choices: Choices) -> float:
        """Return the instant chosen, by default the clip's middle; raises BadRunError for one outside the clip."""
        clip = self.clip
        if choices.at_s is None:
            return clip.middle_s
        if not clip.first_s <= choices.at_s <= clip.last_s:
            expected = f"one within the clip, {clip.first_s:g} to {clip.last_s:g} s"
            raise BadRunError(f"found the instant {choices.at_s:g} s", expected, "change --at")
        return choices.at_s

    def instants_s(self, choices: Choices) -> list[float]:
        """Return the middles of as many equal parts of the clip as frames are chosen, in s on the rig clock."""
        count = choices.frames or FRAMES
        return [self.clip.instant_s((i + 0.5) / count) for i in range(count)]

    def frames(self, choices: Choices, progress: Progress) -> Iterator[tuple[str, float]]:
        """Yield the number, in six digits, and the instant in s of every frame, and report each when it is done."""
        instants = self.instants_s(choices)
        for i, instant_s in enumerate(instants):
            yield f"{i:06d}", instant_s
            progress((i + 1) / len(instants), f"frame {i + 1} of {len(instants)}")

    def camera(self, choices: Choices) -> Camera:
        """Return the camera chosen, by default the held-out one, else the rig's middle one; raises RigError."""
        wanted = choices.camera or self.holdout or self.rig.ids[len(self.rig.ids) // 2]
        return self.rig.camera(wanted)


Writer = Callable[[Path, Scene, Choices, Progress], dict]


@dataclass(frozen=True)
class Format:
    """A form in which other tools read a run; a file of `reconstruction.export.formats` defines one.

    `about` says in a line what it is. `file` names what an export job writes into its own folder: a file, or where the
    name has no suffix a folder with a manifest. `write(path, scene, choices, progress)` makes it and returns what a
    manifest adds. `takes` lists the fields of `Choices` that matter to it. `served`: whether the service offers it.
    """

    name: str
    about: str
    file: str
    write: Writer
    takes: tuple[str, ...]
    served: bool = True

    @property
    def folder(self) -> bool:
        """Return whether it is a folder."""
        return not Path(self.file).suffix
