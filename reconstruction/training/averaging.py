"""Averages a model over the last steps of a training, so that the noise of single steps is not in what it shows.

Every step follows one view at one instant and leaves the model a little beside the optimum for all of them. The mean of
many steps lies nearer, and rates need not run down to nothing. Sources: Polyak & Juditsky, "Acceleration of stochastic
approximation by averaging", 1992; Shamir & Zhang, ICML 2013, for means that reach back a share of the steps so far.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor

EVERY = 4  # steps from one look to the next
SHARE = 0.06  # share of the steps so far that the mean reaches back
MOVING = "moving."  # how names of movers' tensors begin

Named = Iterable[tuple[str, Tensor]]


@dataclass
class Averages:
    """Running means of the learnt tensors of a model, by name; without a look so far they are the tensors themselves.

    `steps`: steps since `restart`. `stage`: how much of the model's own stage was done at the last step. `begun`: the
    steps at which that stage began.
    """

    means: dict[str, Tensor] = field(default_factory=dict)
    steps: int = 0
    stage: float = 0.0
    begun: int = 0

    def see(self, tensors: Named, stage: float) -> None:
        """Take in what a step at `stage` (0 to 1) has left; of movers a new stage of the model begins anew."""
        if stage < self.stage:
            self.means = {name: mean for name, mean in self.means.items() if not name.startswith(MOVING)}
            self.begun = self.steps
        self.stage = stage
        self.steps += 1
        if self.steps % EVERY:
            return
        for name, tensor in tensors:
            if not tensor.requires_grad:
                continue
            steps = self.steps - (self.begun if name.startswith(MOVING) else 0)
            mean = self.means.setdefault(name, tensor.detach().clone())
            mean.lerp_(tensor.detach(), min(1.0, EVERY / (SHARE * steps)))

    def restart(self) -> None:
        """Forget all, where the tensors become others."""
        self.means, self.steps, self.stage, self.begun = {}, 0, 0.0, 0

    def put_into(self, tensors: Named) -> None:
        """Give tensors of the same names the values of the means."""
        with torch.no_grad():
            for name, tensor in tensors:
                if name in self.means:
                    tensor.copy_(self.means[name])

    def state(self) -> dict[str, Any]:
        """Return tensors and numbers, the arguments of averages that go on from here."""
        return {**vars(self), "means": {name: mean.clone() for name, mean in self.means.items()}}
