"""Draws the views and instants of the steps evenly, so that a short training sees all of the recording alike."""

import json
from typing import Any

import numpy as np

GOLDEN = (5**0.5 - 1) / 2  # of all strides, the one whose multiples fill the unit interval most evenly at any length


class Draws:
    """The random choices of a training of `views` views; `state` and `restore` carry them on exactly.

    `rng` is for choices that need not be even.
    """

    def __init__(self, views: int, seed: int):
        self.views, self.rng = views, np.random.default_rng(seed)
        self.left: list[int] = []  # views that the round under way has not come to
        self.at = float(self.rng.random())

    def view(self) -> int:
        """Return the number of the next view; every round has each of them once, in an order of its own."""
        if not self.left:
            self.left = [int(i) for i in self.rng.permutation(self.views)]
        return self.left.pop()

    def place(self, count: int) -> int:
        """Return a place below `count`; successive ones are spread evenly."""
        self.at = (self.at + GOLDEN) % 1
        return min(int(self.at * count), count - 1)

    def state(self) -> dict[str, Any]:
        """Return numbers and a string, for a checkpoint."""
        return {"rng": json.dumps(self.rng.bit_generator.state), "left": list(self.left), "at": self.at}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from `state`."""
        self.rng.bit_generator.state = json.loads(state["rng"])
        self.left, self.at = list(state["left"]), state["at"]
