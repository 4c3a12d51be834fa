"""Volume rendering along rays: light, alpha and the layer of half the light, in C++ and as its readable torch twin.

A sample reads the eight cells around its place. Their raw densities are interpolated, and `softplus` makes the optical
depth of a layer of them; activated after interpolation, edges are sharper than cells (Sun et al., "DVGO", CVPR 2022).
Cells that a grid does not hold are EMPTY and have no intensity. Two grids may overlap: one stands still, the other is
read where `offsets` lead, and their densities add. Letters: R rays, S samples, D layers, H rows, W columns, C cells.
"""

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.autograd import Function
from torch.autograd.function import once_differentiable
from torch.nn.functional import softplus

from acquisition.native import Address
from reconstruction.native import Addresses, Int, Long, addresses, kernel, threads

BLOCK = (8, 8, 4)  # nodes of a block of `near`
KNOT = (16, 16, 8)  # nodes between knots of the offsets
EMPTY = -6.0  # raw density where there is no cell
MOST = 1e18  # largest optical depth of a layer
STEP = 1.0  # layers between samples


@dataclass(frozen=True, eq=False)
class Grid:
    """The cells of a grid: `lookup` [H, W, D] int32 has the cell at each node, or -1.

    `near`, uint8 by blocks, says whether samples in a block can meet any.
    """

    lookup: Tensor
    near: Tensor


class Marched(NamedTuple):
    """Light [R] in spikes per tick, alpha [R], and the layer [R] where half of the light is taken, else NaN."""

    light: Tensor
    alpha: Tensor
    middle: Tensor


class _Field(ctypes.Structure):
    _fields_ = (
        ("grids", ctypes.c_void_p * 4),
        ("tensors", ctypes.c_void_p * 3),  # raw densities, intensities, offsets
        ("sizes", ctypes.c_int64 * 2),  # cells, numbers of the offsets
        ("shape", ctypes.c_int32 * 3),
        ("knots", ctypes.c_int32 * 3),
        ("parts", ctypes.c_int32),
        ("step", ctypes.c_float),
    )


_MARCH = (ctypes.POINTER(_Field), Address, Address, Long)  # the field, lines, jitter, and how many of them
_forward = kernel("march_forward", *_MARCH, Addresses, Int)
_backward = kernel("march_backward", *_MARCH, Addresses, Addresses, Addresses, Int)


def _field(grids: tuple[Grid, ...], tensors: Sequence[Tensor], step: float) -> _Field:
    raws, _, offsets = tensors
    return _Field(
        addresses(*(t for grid in grids for t in (grid.lookup, grid.near)), *[None] * (4 - 2 * len(grids))),
        addresses(*tensors),
        (ctypes.c_int64 * 2)(len(raws), offsets.numel()),
        (ctypes.c_int32 * 3)(*grids[0].lookup.shape),
        (ctypes.c_int32 * 3)(*offsets.shape[:3]),
        len(grids),
        step,
    )


class _March(Function):
    @staticmethod
    def forward(
        ctx: Any, grids: tuple[Grid, ...], lines: Tensor, jitter: Tensor, step: float, *tensors: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        raws, intensities, offsets = (t.contiguous() for t in tensors)
        out = tuple(torch.empty(len(lines)) for _ in range(3))
        field = _field(grids, (raws, intensities, offsets), step)
        _forward(field, lines, jitter, len(lines), addresses(*out), threads())
        ctx.grids, ctx.step = grids, step
        ctx.save_for_backward(lines, jitter, raws, intensities, offsets, *out[:2])
        ctx.mark_non_differentiable(out[2])
        return out  # type: ignore[return-value]

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:  # pyright: ignore[reportIncompatibleMethodOverride]
        lines, jitter, raws, intensities, offsets, light, alpha = ctx.saved_tensors
        wanted = [g.contiguous() for g in gradients[:2]]
        out = tuple(torch.zeros_like(t) for t in (raws, intensities, offsets))
        field = _field(ctx.grids, (raws, intensities, offsets), ctx.step)
        seen = (addresses(light, alpha), addresses(*wanted), addresses(*out))
        _backward(field, lines, jitter, len(lines), *seen, threads())
        return (None, None, None, None, *out)


def march(
    grids: tuple[Grid, ...], lines: Tensor, jitter: Tensor, step: float, tensors: tuple[Tensor, Tensor, Tensor]
) -> Marched:
    """Return what rays meet that are sampled every `step` layers, the first time `jitter` [R] of a step on.

    `lines` [R, 6] as in `frustum.Rays`. `tensors`: raw densities [C], intensities [C] in spikes per tick, and offsets
    [h, w, d, 3] in nodes (y, x, w) at knots every KNOT nodes, of any size where `grids` has no second one.
    Differentiable in all three; float32 on the CPU.
    """
    return Marched(*_March.apply(grids, lines.contiguous(), jitter.contiguous(), step, *tensors))


def march_reference(
    grids: tuple[Grid, ...], lines: Tensor, jitter: Tensor, step: float, tensors: tuple[Tensor, Tensor, Tensor]
) -> Marched:
    """Compute `march` in torch, in any float type on any device; every sample is read, which takes much memory."""
    raws, intensities, offsets = tensors
    x, y, dx, dy, stretch, first = lines.to(raws).unbind(1)
    shape = grids[0].lookup.shape
    counts = torch.arange(max(0, int((shape[2] - 1) / step) + 1), device=raws.device)
    w = first[:, None] + (counts + jitter.to(raws)[:, None]) * step  # [R, S]
    places = torch.stack([y[:, None] + w * dy[:, None], x[:, None] + w * dx[:, None], w], -1)
    sigma, light = torch.zeros_like(w), torch.zeros_like(w)
    for part, grid in enumerate(grids):
        moved, reached = places, _near(grid, places)
        if part:
            shifts, inside = _shifts(offsets, places)
            moved, reached = places + shifts, reached & inside
        own, value = _read(grid, moved, reached, raws, intensities)
        sigma, light = sigma + own, light + own * value
    value = light / sigma.clamp_min(1e-30)
    depth = sigma * stretch[:, None] * step
    after = torch.exp(-depth.cumsum(1))
    before = torch.cat([torch.ones_like(after[:, :1]), after[:, :-1]], 1)
    half = (before >= 0.5) & (after < 0.5)
    where = w + step * (torch.log(2 * before) / depth.clamp_min(1e-30) - jitter.to(raws)[:, None])
    middle = torch.where(half.any(1), torch.where(half, where, torch.zeros_like(where)).sum(1), torch.nan)
    return Marched(((before - after) * value).sum(1), 1 - after[:, -1], middle.detach())


def _within(places: Tensor, shape: tuple[int, ...]) -> Tensor:
    """Return which of `places` [..., 3], in nodes, have eight nodes of a grid of this shape around them."""
    last = torch.tensor(shape, device=places.device) - 1
    return ((places >= 0) & (places < last)).all(-1)


def _near(grid: Grid, places: Tensor) -> Tensor:
    """Return which of `places` [..., 3], in nodes, lie in a block near to cells."""
    inside = _within(places, grid.lookup.shape)
    at = torch.where(inside[..., None], places, torch.zeros_like(places)).long()
    blocks = [at[..., axis] // BLOCK[axis] for axis in range(3)]
    return inside & grid.near[tuple(blocks)].bool()


def _corners(places: Tensor) -> tuple[Tensor, Tensor]:
    """Return the nodes [..., 8, 3] around `places` [..., 3], and their trilinear weights [..., 8]."""
    low = places.detach().floor()
    up = torch.tensor(list(product((0, 1), repeat=3)), device=places.device)
    share = (places - low)[..., None, :]
    weights = torch.where(up.bool(), share, 1 - share).prod(-1)
    return low.long()[..., None, :] + up, weights


def _shifts(offsets: Tensor, places: Tensor) -> tuple[Tensor, Tensor]:
    """Return what `offsets` [h, w, d, 3] add to `places` [R, S, 3], and where they cover them [R, S]."""
    knots = places / torch.tensor(KNOT, device=places.device)
    inside = _within(knots, offsets.shape[:3])
    nodes, weights = _corners(torch.where(inside[..., None], knots, torch.zeros_like(knots)))
    return (offsets[tuple(nodes.unbind(-1))] * weights[..., None]).sum(-2), inside


def _read(grid: Grid, places: Tensor, reached: Tensor, raws: Tensor, intensities: Tensor) -> tuple[Tensor, Tensor]:
    """Return optical depths of a layer and intensities [R, S] at `places` [R, S, 3]; zero unless `reached` [R, S]."""
    if not len(raws):
        return (nothing := torch.zeros_like(places[..., 0]) + raws.sum()), nothing
    reached = reached & _within(places, grid.lookup.shape)
    nodes, weights = _corners(torch.where(reached[..., None], places, torch.zeros_like(places)))
    cells = grid.lookup[tuple(nodes.unbind(-1))].long()
    there = (cells >= 0).to(weights)
    held = (weights * there).sum(-1)
    raw = (weights * torch.where(cells >= 0, raws[cells.clamp_min(0)], EMPTY)).sum(-1)
    value = (weights * there * intensities[cells.clamp_min(0)]).sum(-1) / held.clamp_min(1e-30)
    hit = reached & (held > 0)
    sigma = softplus(raw).clamp_max(MOST)
    return torch.where(hit, sigma, torch.zeros_like(raw)), torch.where(hit, value, torch.zeros_like(value))
