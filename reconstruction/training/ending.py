"""Ends a training before its budget when more of it gains nothing: the loss stands still, then the rates run down.

Losses of single steps differ by view and instant far more than a training gains in a hundred steps, so whole windows of
steps are compared, every view counting the same in each: the mean of the last PATIENCE windows with that of as many
before them. While rates are high the loss stands still above what lower rates reach. So once it does, the rates run
down to their final values within a share RUN_DOWN of the steps so far, and only then the training ends.

A loss may fall on and on by the noise of the images, learnt by heart. A method may therefore say how many steps are
enough; its rates then fall as in a training of so many steps, however many the budget has room for.
"""

import copy
from dataclasses import dataclass, field

import numpy as np

WINDOW = 500  # steps of a window
PATIENCE = 3  # windows that are compared with as many before
LEAST_GAIN = 0.002  # share of the loss that is gained from PATIENCE windows to the next, at least
RUN_DOWN = 0.25  # share of the steps so far in which the rates run down


@dataclass
class Ending:
    """Watches the losses of `views` training views.

    `enough`: steps at which a training ends in any case (None: never). `windows`: mean losses of the windows that are
    complete. `totals` and `counts` [V]: losses and steps by view in the window under way. `began`: the step at which
    the rates started to run down, `share` of the training at that step.
    """

    views: int
    enough: int | None = None
    windows: list[float] = field(default_factory=list)
    began: int | None = None
    share: float = 0.0
    totals: list[float] = field(default_factory=list)
    counts: list[int] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.totals, self.counts = self.totals or [0.0] * self.views, self.counts or [0] * self.views

    def see(self, view: int, loss: float, steps: int, share: float) -> None:
        """Take in the loss of one step on `view`; `steps` have been done, a `share` of the training."""
        if self.began is not None:
            return
        self.totals[view] += loss
        self.counts[view] += 1
        if sum(self.counts) < WINDOW:
            return
        means = [total / count for total, count in zip(self.totals, self.counts, strict=True) if count]
        self.windows.append(float(np.mean(means)))
        self.totals, self.counts = [0.0] * self.views, [0] * self.views
        if self.stands_still():
            self.began, self.share = steps, share

    def stands_still(self) -> bool:
        """Return whether the last PATIENCE windows are no better than those before."""
        if len(self.windows) < 2 * PATIENCE:
            return False
        before, after = self.windows[-2 * PATIENCE : -PATIENCE], self.windows[-PATIENCE:]
        return float(np.mean(after)) > (1 - LEAST_GAIN) * float(np.mean(before))

    def done(self, share: float, steps: int) -> float:
        """Return the share of the training that is done: as the budget has it, or more where it ends before."""
        if self.enough:
            share = max(share, steps / self.enough)
        if self.began is not None:
            down = (steps - self.began) / max(1.0, RUN_DOWN * self.began)
            share = max(share, self.share + (1 - self.share) * down)
        return min(1.0, share)

    def reason(self, steps: int) -> str:
        """Return why it ended after `steps`."""
        if self.enough and steps >= self.enough:
            return f"{self.enough} steps are enough: more of them learn the noise of the images by heart"
        gain = 1 - float(np.mean(self.windows[-PATIENCE:])) / float(np.mean(self.windows[-2 * PATIENCE : -PATIENCE]))
        return (
            f"the loss fell by {gain:.2%} over {PATIENCE * WINDOW} steps, less than {LEAST_GAIN:.1%}; "
            f"rates ran down from step {self.began}"
        )

    def state(self) -> dict:
        """Return plain numbers, the arguments of an ending that goes on from here."""
        return copy.deepcopy(vars(self))
