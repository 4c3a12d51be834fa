"""Measures how much of a training is done; light enough for stages without torch."""

from collections.abc import Callable
from dataclasses import dataclass

from reconstruction.errors import ReconstructionError


class StoppedError(ReconstructionError):
    """Training was asked to stop; its checkpoint is written and the same command resumes it."""

    exit_code = 143
    bad_input = False


@dataclass
class Budget:
    """Measures how much of a training is done, by seconds of the run or by steps.

    `spent_s`: seconds of the run before this process. `before_training_s`: seconds of the run before its training.
    """

    clock: Callable[[], float]
    started: float
    spent_s: float
    budget_s: float | None
    steps: int | None
    before_training_s: float = 0.0

    def elapsed_s(self) -> float:
        """Return the wall seconds of the run so far, earlier stages and processes included."""
        return self.spent_s + self.clock() - self.started

    @property
    def is_missed(self) -> bool:
        """Tell whether the seconds were over before the training began."""
        return self.budget_s is not None and self.budget_s <= self.before_training_s

    def done(self, steps: int) -> float:
        """Return the share of the training that is done after so many steps, 0 to 1."""
        if self.steps is not None:
            return min(1.0, steps / self.steps)
        assert self.budget_s is not None
        room = self.budget_s - self.before_training_s
        return 1.0 if room <= 0 else min(1.0, max(0.0, self.elapsed_s() - self.before_training_s) / room)
