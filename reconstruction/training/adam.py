"""Adam in one native call a step: values, gradients and both moments of every tensor are passed once.

torch's own is the reference; state, groups and their names are the same, so either reads the other's state.
"""

import ctypes
import math
from collections.abc import Callable, Iterable

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


class Adam(torch.optim.Optimizer):
    """`torch.optim.Adam` for contiguous float32 leaves on the CPU; `groups` as torch takes them, each with its `lr`.

    Leaves without a gradient are left alone. Raises ReconstructionError for any other kind of tensor.
    """

    def __init__(self, groups: Iterable[dict], betas: tuple[float, float] = BETAS, eps: float = EPS):
        super().__init__(groups, {"lr": 1e-3, "betas": betas, "eps": eps})
        self.betas, self.eps = betas, eps
        for group in self.param_groups:
            for leaf in group["params"]:
                if not (fits(leaf) and leaf.is_contiguous()):
                    raise ReconstructionError(
                        f"found a leaf of {leaf.dtype} on {leaf.device}",
                        "contiguous float32 on the CPU",
                        "use torch.optim.Adam",
                    )

    @torch.no_grad()
    def step(self, closure: Callable[[], float] | None = None) -> None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Update every leaf that has a gradient."""
        assert closure is None
        kept, leaves = [], []
        for group in self.param_groups:
            for leaf in group["params"]:
                if leaf.grad is not None and leaf.numel():
                    gradient = leaf.grad.contiguous()
                    kept.append(gradient)
                    leaves.append(self._leaf(leaf, gradient, group["lr"]))
        _step((_Leaf * len(leaves))(*leaves), len(leaves), *self.betas, self.eps, threads())

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
