"""Follows a recording while it is written: a look at its newest planes, again and again, until it is whole.

A look is the reconstruction of a short part. Its first pictures and its scene are shown under the names of the run, so
that a person sees them long before the run itself begins, which is when the recording is whole. The run begins from
nothing: what was shown changes nothing of it.
"""

import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

from acquisition.durable import write_durably, write_json
from acquisition.errors import BadRecordingError
from acquisition.progress import Progress
from acquisition.recording.growing import is_written, open_growing
from acquisition.recording.reader import Recording
from acquisition.revision import code_revision
from reconstruction.errors import BadRunError
from reconstruction.pipeline.budget import StoppedError
from reconstruction.pipeline.stages import reconstruct
from reconstruction.run.configuration import ReconstructionConfig
from reconstruction.run.folder import PREVIEW, RunFolder
from reconstruction.run.spans import PLANES
from rigs.errors import Spike4dgsError

LOOK_S = 20.0  # most seconds of a look, from its last plane to its scene
LOOK, LOOKS = "look", "looks.json"  # the run of the look at work, and what all of them took
_POLL_S, _PATIENCE_S = 0.2, 60.0  # seconds between questions for new planes, and until a recording has to begin
_QUIET_S = 5.0  # seconds without new planes, after which its writer is asked for


@dataclass(frozen=True)
class Look:
    """The look at the ticks [first_tick, last_tick]: seconds from its planes to the first picture and to the scene.

    None where it came to neither, for the reason `failed`.
    """

    first_tick: int
    last_tick: int
    picture_s: float | None = None
    scene_s: float | None = None
    failed: str | None = None


def follow(
    recording: Path,
    out: Path,
    config: ReconstructionConfig,
    progress: Progress,
    should_stop: Callable[[], bool] = lambda: False,
) -> list[Look]:
    """Look at the newest planes of `recording` until it is whole, and show each look in the run folder `out`.

    Return the looks; a recording that is whole already gets none. Raises BadRecordingError where it is neither written
    nor begun in time, BadRunError as `reconstruct`, and StoppedError.
    """
    if config.from_tick is not None or config.to_tick is not None:
        raise BadRunError("found a part of a recording to follow", "all of it", "leave out the ticks")
    run = RunFolder.start(out, config, recording, code_revision())
    with run.locked():
        follower = _Follower(recording, run, progress, should_stop)
        for growing in follower.newest():
            follower.look(growing)
    return follower.looks


@dataclass
class _Follower:
    """Follows one recording for the run `run`."""

    recording: Path
    run: RunFolder
    progress: Progress
    should_stop: Callable[[], bool]
    looks: list[Look] = field(default_factory=list)
    shown: list[bytes] = field(default_factory=list)  # the picture and what is told of it

    def newest(self) -> Iterator[Recording]:
        """Yield the newest planes of the recording each time there are enough that no look has seen."""
        seen, found, moved = 0, -1, time.monotonic()
        while not self.recording.exists():
            self._expect_wanted()
            growing = self._growing()
            planes = growing.planes if growing else -1
            if planes != found:
                found, moved = planes, time.monotonic()
            self._expect_alive(time.monotonic() - moved, begun=planes >= 0)
            if growing and planes - seen >= PLANES:
                seen = planes
                yield growing.part(growing.ticks.stop - PLANES, growing.ticks.stop)
            else:
                self.progress(0.0, f"{max(0, planes)} planes recorded, {len(self.looks)} looks")
                time.sleep(_POLL_S)

    def look(self, growing: Recording) -> None:
        """Reconstruct a part of the recording, and show it; a failure is noted."""
        began, ticks = time.monotonic(), growing.ticks
        folder, own = self.run.path / LOOK, self.run.config
        budget_s = None if own.budget_s is None else min(LOOK_S, own.budget_s)
        config = replace(own, from_tick=ticks.start, to_tick=ticks.stop, budget_s=budget_s, span=None)  # in one piece
        took = Look(ticks.start, ticks.stop - 1)

        def show(fraction: float, message: str) -> None:
            nonlocal took
            if self._show_picture(folder) and took.picture_s is None:
                took = replace(took, picture_s=round(time.monotonic() - began, 2))
            *_, last = message.splitlines() or [""]
            self.progress(0.0, f"ticks {ticks.start} to {ticks.stop - 1}: {last}")

        shutil.rmtree(folder, ignore_errors=True)  # of one that was stopped
        try:
            look = reconstruct(
                *(self.recording, folder, config, lambda _: show),
                last="train",
                started=began,
                should_stop=self.should_stop,
                grows=True,
            )
            self._show_scene(look)
            took = replace(took, scene_s=round(time.monotonic() - began, 2))
        except StoppedError:
            raise
        except Spike4dgsError as error:
            took = replace(took, failed=str(error))
        finally:
            shutil.rmtree(folder, ignore_errors=True)
        self.looks.append(took)
        write_json(self.run.path / LOOKS, {"looks": [asdict(look) for look in self.looks]})

    def _show_picture(self, folder: Path) -> bool:
        """Show the newest picture of a look as that of the run, unless it is shown; return whether there is one."""
        with suppress(FileNotFoundError):
            pictures = [(folder / name).read_bytes() for name in PREVIEW]
            if pictures != self.shown:
                for name, data in zip(PREVIEW, pictures, strict=True):
                    write_durably(self.run.path / name, data)
                self.shown = pictures
            return True
        return False

    def _show_scene(self, look: RunFolder) -> None:
        """Write the scene of a look for the viewer, where the model can be played there."""
        from reconstruction.export.viewer import write_viewer
        from reconstruction.gaussians.dynamic import DynamicCloud
        from reconstruction.pipeline.artefacts import posed
        from reconstruction.pipeline.trained_scene import scene_of
        from reconstruction.training.checkpoint import load_cloud

        cloud = load_cloud(look.checkpoint)
        if isinstance(cloud, DynamicCloud):
            growing = look.config.part_of(open_growing(self.recording))
            write_viewer(self.run.path, scene_of(look, posed(look, growing, refined=True), cloud))

    def _growing(self) -> Recording | None:
        """Return the recording as far as it is written; None before its first plane, or while it gets its name."""
        try:
            return open_growing(self.recording)
        except Spike4dgsError:
            return None

    def _expect_wanted(self) -> None:
        if self.should_stop():
            raise StoppedError("stopped", do="the same command goes on", where=self.run.path)

    def _expect_alive(self, quiet_s: float, *, begun: bool) -> None:
        """Raise BadRecordingError where the recording does not begin, or its writer has died."""
        if quiet_s < (_QUIET_S if begun else _PATIENCE_S) or is_written(self.recording) or self.recording.exists():
            return
        found = "found nobody who writes it" if begun else f"found nothing there within {_PATIENCE_S:.0f} s"
        do = f"call `spike4dgs finalise {self.recording}` and then reconstruct" if begun else "begin to record it"
        raise BadRecordingError(found, "a recording that is written or whole", do, where=self.recording)
