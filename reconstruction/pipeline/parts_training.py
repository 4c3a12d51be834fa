"""Learns the parts of a training in spans, each once: the still scene, then spans, several of them side by side.

Each part has a share of the training's seconds that is its own, whichever process learns it, and leaves a file. So a
run that was stopped or killed goes on with the next part, and several processes can share the parts.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import chain
from threading import Lock
from typing import Any

from acquisition.progress import Progress
from acquisition.recording.reader import Recording
from reconstruction.errors import BadRunError
from reconstruction.gaussians.cloud import GaussianCloud
from reconstruction.gaussians.spanned import SpanContent
from reconstruction.heap import give_back
from reconstruction.native import shared_out, threads
from reconstruction.pipeline.budget import Budget, StoppedError
from reconstruction.pipeline.part_file import Beat, PartFile
from reconstruction.pipeline.span_artefacts import parts_to_learn
from reconstruction.pipeline.span_training import learn_span, learn_still
from reconstruction.run.configuration import STAGES
from reconstruction.run.folder import RunFolder
from reconstruction.run.parts import STILL, Part, PartFolder, shares_of
from reconstruction.training.trainer import Trainer

SIDE_BY_SIDE = 2  # spans that are learnt at once: each takes a few hundred megabytes


class PartError(BadRunError):
    """A part of a training that was given up, without which there is nothing to show."""

    exit_code = 1

    def __init__(self, found: str, *, bad_input: bool) -> None:
        super().__init__(found, do="run the stage again, or its part")
        self.bad_input = bad_input


@dataclass
class SpanTraining:
    """The training of one run: `seconds` by part that is read, and `steps` of all of them.

    `parts` are all of them, noted or not given, in an order in which they can be learnt one after the other.
    """

    run: RunFolder
    recording: Recording
    progress: Progress
    budget: Budget
    should_stop: Callable[[], bool]
    parts: list[Part] = field(default_factory=list)
    steps: int = 0
    seconds: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.parts = self.parts or PartFolder(self.run.path).noted() or parts_to_learn(self.run)
        done = self.run.document.seconds
        self.before_s = sum(done[name] for name in STAGES[: STAGES.index("train")] if name in done)
        self.budget.before_training_s = self.before_s
        self.folder, self.shares = PartFolder(self.run.path), shares_of(self.parts)
        self._done = dict.fromkeys(self.folder.there() | self.folder.given_up(), 1.0)
        self._telling = Lock()

    @property
    def elapsed_s(self) -> float:
        """The seconds of the run until the last part that was read was learnt, by one process after the other."""
        return self.before_s + sum(self.seconds.values())

    def file(self, name: str) -> PartFile:
        """Return the file of a part."""
        return PartFile(self.folder, name, self._pause)

    def still(self) -> GaussianCloud:
        """Return the still scene, learnt now if it was not before; raises PartError where it was given up."""
        failure = self.folder.failure(STILL)
        if failure is not None and not self.file(STILL).is_there:
            found = f"found the still scene given up after {failure.tries} tries: {failure.reason}"
            raise PartError(found, bad_input=failure.bad_input)
        self.learn(STILL, partial(self._tell, STILL))
        return GaussianCloud(**self.content(STILL))

    def spans(self, names: Sequence[str], still: GaussianCloud) -> Iterator[tuple[str, SpanContent, bool]]:
        """Yield each span's name, what it has of its own, and whether it was learnt now, in the order of `names`.

        Those that are not there are learnt SIDE_BY_SIDE at a time, so that no thread waits for another one. A last one
        that is left over is learnt by all threads.
        """
        due = [name for name in names if not self.file(name).is_there]
        beside = max(1, min(SIDE_BY_SIDE, threads(), len(due)))
        left_over = len(due) % beside if beside > 1 else len(due)
        together = len(names) if not left_over else names.index(due[-left_over])

        def learnt(name: str, beside: int = 1) -> tuple[str, bool]:
            return name, self.learn(name, partial(self._tell, name), still, beside)

        side_by_side = shared_out(partial(learnt, beside=beside), names[:together], SIDE_BY_SIDE)
        for name, is_new in chain(side_by_side, map(learnt, names[together:])):
            yield name, SpanContent.from_state(self.content(name)), is_new

    def learn(self, name: str, told: Progress, still: GaussianCloud | None = None, beside: int = 1) -> bool:
        """Learn a part unless it is there; return whether this process's result was kept, and no earlier one.

        A span is learnt beside the `still` scene. Of `beside` parts that are learnt at once, each has so many times its
        seconds.
        """

        def learnt(beat: Beat) -> dict[str, Any]:
            began, counted = self.budget.elapsed_s(), _Steps()
            task = (self.done_of(name, beside), self._on_step(name, told, counted, beat))
            if still is None:
                content = vars(learn_still(self.run, self.recording, *task))
            else:
                content = learn_span(self.run, self.recording, int(name), still, *task).state()
            seconds = (self.budget.elapsed_s() - began) / beside
            return {"content": content, "seconds": seconds, "steps": counted.steps}

        kept = self.file(name).keep(learnt)
        self._done[name] = 1.0
        give_back()  # the images of a span and its planes
        return kept

    def content(self, name: str) -> dict[str, Any]:
        """Return what was learnt of a part, and count its seconds and steps."""
        kept = self.file(name).read()
        self.steps += kept["steps"]
        self.seconds[_label(name)] = kept["seconds"]
        return kept["content"]

    def done_of(self, name: str, beside: int = 1) -> Callable[[int], float]:
        """Return the share of a part that is done after so many steps of it, by the seconds that are its own.

        These are `beside` times as many where so many parts are learnt at once.
        """
        if self.budget.steps is not None:
            return self.budget.done
        first, last = self.shares[name]
        room_s = (self.budget.budget_s or 0.0) - self.before_s
        began, own_s = self.budget.elapsed_s(), room_s * (last - first) * beside
        return lambda _: 1.0 if own_s <= 0 else min(1.0, (self.budget.elapsed_s() - began) / own_s)

    def _tell(self, name: str, share: float, said: str) -> None:
        """Report how far all parts are, where a share of one is done."""
        with self._telling:
            self._done[name] = share
            done = sum((last - first) * self._done.get(part, 0.0) for part, (first, last) in self.shares.items())
            self.progress(min(1.0, done), said)

    def _on_step(
        self, name: str, told: Progress, counted: "_Steps", beat: Beat
    ) -> Callable[[Trainer, float, float], None]:
        label = _label(name)

        def on_step(trainer: Trainer, share: float, loss: float) -> None:
            counted.steps = trainer.steps
            if trainer.steps % 10 == 0 or share >= 1:
                beat()
                told(share, f"{label}: step {trainer.steps}, loss {loss:.4f}{trainer.closeness}")
            if share < 1:
                self._expect_more(f"stopped in {label} at step {trainer.steps}")

        return on_step

    def _pause(self, seconds: float) -> None:
        self._expect_more("stopped while another process learnt a part")
        time.sleep(seconds)

    def _expect_more(self, found: str) -> None:
        if self.should_stop():
            raise StoppedError(found, do="the same command resumes it", where=self.run.path)


@dataclass
class _Steps:
    """The steps of one part so far."""

    steps: int = 0


def _label(name: str) -> str:
    return name if name == STILL else f"span {int(name)}"
