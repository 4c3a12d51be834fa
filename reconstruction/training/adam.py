"""Adam in one native call a step: values, gradients and both moments of every tensor are passed once.

torch's own is the reference; state, groups and their names are the same, so either reads the other's state. It is no
`torch.optim.Optimizer`, the first of which imports torch's compiler, and that takes more than a second.
"""

import ctypes
import math
from collections import defaultdict
from collections.abc import Iterable, Iterator
from typing import Any

import torch
from torch import Tensor

from reconstruction.errors import ReconstructionError
from reconstruction.native import Double, Int, addresses, fits, kernel, threads

BETAS, EPS = (0.9, 0.99), 1e-15


class _Leaf(ctypes.Structure):
    _fields_ = (
        ("tensors", ctypes.c_void_p * 4),
        ("count", ctypes.c_int64),
        ("step_size", ctypes.c_double),
        ("inverse_root", ctypes.c_double),
    )


_step = kernel("adam_step", ctypes.POINTER(_Leaf), Int, Double, Double, Double, Int)


class Adam:
    """`torch.optim.Adam` for contiguous float32 leaves on the CPU; `groups` as torch takes them, each with its `lr`.

    Leaves without a gradient are left alone. Raises ReconstructionError for any other kind of tensor.
    """

    def __init__(self, groups: Iterable[dict[str, Any]], betas: tuple[float, float] = BETAS, eps: float = EPS):
        self.betas, self.eps = betas, eps
        self.param_groups = [{**group, "betas": betas, "eps": eps} for group in groups]
        self.state: defaultdict[Tensor, dict[str, Tensor]] = defaultdict(dict)
        for leaf in self._leaves():
            if not (fits(leaf) and leaf.is_contiguous()):
                raise ReconstructionError(
                    f"found a leaf of {leaf.dtype} on {leaf.device}",
                    "contiguous float32 on the CPU",
                    "use torch.optim.Adam",
                )

    def _leaves(self) -> Iterator[Tensor]:
        return (leaf for group in self.param_groups for leaf in group["params"])

    @torch.no_grad()
    def step(self) -> None:
        """Update every leaf that has a gradient."""
        kept, leaves = [], []
        for group in self.param_groups:
            for leaf in group["params"]:
                if leaf.grad is not None and leaf.numel():
                    gradient = leaf.grad.contiguous()
                    kept.append(gradient)
                    leaves.append(self._leaf(leaf, gradient, group["lr"]))
        _step((_Leaf * len(leaves))(*leaves), len(leaves), *self.betas, self.eps, threads())

    def zero_grad(self, *, set_to_none: bool = True) -> None:
        """Forget the gradients, or set them to zero."""
        for leaf in self._leaves():
            if set_to_none or leaf.grad is None:
                leaf.grad = None
            else:
                leaf.grad.zero_()

    def state_dict(self) -> dict[str, Any]:
        """Return state and groups with numbers for the leaves, as torch does."""
        numbers = {leaf: number for number, leaf in enumerate(self._leaves())}
        groups = [{**group, "params": [numbers[leaf] for leaf in group["params"]]} for group in self.param_groups]
        return {"state": {numbers[leaf]: state for leaf, state in self.state.items()}, "param_groups": groups}

    def load_state_dict(self, stored: dict[str, Any]) -> None:
        """Go on from what `state_dict` returned; raises ValueError for that of other groups."""
        leaves, pairs = list(self._leaves()), list(zip(self.param_groups, stored["param_groups"], strict=True))
        if any(len(group["params"]) != len(other["params"]) for group, other in pairs):
            raise ValueError("found groups of other sizes")
        self.param_groups = [{**other, "params": group["params"]} for group, other in pairs]
        self.state = defaultdict(dict, {leaves[number]: dict(state) for number, state in stored["state"].items()})

    def _leaf(self, leaf: Tensor, gradient: Tensor, rate: float) -> _Leaf:
        state = self.state[leaf]
        if not state:
            state["step"] = torch.zeros(())
            state["exp_avg"], state["exp_avg_sq"] = torch.zeros_like(leaf), torch.zeros_like(leaf)
        state["step"] += 1
        steps = int(state["step"])
        return _Leaf(
            addresses(leaf, state["exp_avg"], state["exp_avg_sq"], gradient),
            leaf.numel(),
            rate / (1 - self.betas[0] ** steps),
            1 / math.sqrt(1 - self.betas[1] ** steps),
        )
