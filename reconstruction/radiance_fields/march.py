"""Volume rendering along rays: light, alpha and the layer of half the light, in C++ and as its readable torch twin.

A sample at a place reads eight cells: what `softplus` makes of their interpolated raw densities is the optical depth of
a layer (activated after interpolation, so that edges are sharper than cells: Sun et al., "DVGO", CVPR 2022); cells a
grid does not hold are EMPTY and have no intensity. Two grids overlap: one stands still, one is read where `offsets`
lead (its densities add). Letters: R rays, S samples, D layers, H rows, W columns, C cells.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from itertools import product
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.autograd import Function
from torch.autograd.function import once_differentiable
from torch.nn.functional import softplus

from reconstruction.native import library

BLOCK = (8, 8, 4)  # nodes of a block of `near`
KNOT = (16, 16, 8)  # nodes between knots of the offsets
EMPTY = -6.0  # raw density
MOST = 1e18  # optical depth of a layer
STEP = 1.0  # layers between samples


@dataclass(frozen=True, eq=False)
class Grid:
    """`lookup` [H, W, D] int32: the cell at a node, -1 where none; `near`, by blocks, where samples can meet any."""

    lookup: Tensor
    near: Tensor


class Marched(NamedTuple):
    """`light` [R] in spikes per tick, `alpha` [R]; `middle` [R]: the layer where half is taken, NaN where less is."""

    light: Tensor
    alpha: Tensor
    middle: Tensor


class _Field(ctypes.Structure):
    _fields_ = (
        ("grids", ctypes.c_void_p * 4),
        ("raws", ctypes.c_void_p),
        ("intensities", ctypes.c_void_p),
        ("offsets", ctypes.c_void_p),
        ("cells", ctypes.c_int64),
        ("offset_count", ctypes.c_int64),
        ("shape", ctypes.c_int32 * 3),
        ("knots", ctypes.c_int32 * 3),
        ("parts", ctypes.c_int32),
        ("step", ctypes.c_float),
    )


def _field(grids: tuple[Grid, ...], tensors: tuple[Tensor, Tensor, Tensor], step: float) -> _Field:
    raws, intensities, offsets = tensors
    pointers = [t.data_ptr() for grid in grids for t in (grid.lookup, grid.near)]
    return _Field(
        (ctypes.c_void_p * 4)(*pointers),
        raws.data_ptr(),
        intensities.data_ptr(),
        offsets.data_ptr(),
        len(raws),
        offsets.numel(),
        (ctypes.c_int32 * 3)(*grids[0].lookup.shape),
        (ctypes.c_int32 * 3)(*offsets.shape[:3]),
        len(grids),
        step,
    )


def _pointers(*tensors: Tensor) -> ctypes.Array:
    return (ctypes.c_void_p * len(tensors))(*(t.data_ptr() for t in tensors))


class _March(Function):
    @staticmethod
    def forward(
        ctx: Any, grids: tuple[Grid, ...], lines: Tensor, jitter: Tensor, step: float, *tensors: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        raws, intensities, offsets = (t.contiguous() for t in tensors)
        out = tuple(torch.empty(len(lines)) for _ in range(3))
        library().march_forward(
            ctypes.byref(_field(grids, (raws, intensities, offsets), step)),
            *(ctypes.c_void_p(t.data_ptr()) for t in (lines, jitter)),
            ctypes.c_int64(len(lines)),
            _pointers(*out),
            torch.get_num_threads(),
        )
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
        library().march_backward(
            ctypes.byref(_field(ctx.grids, (raws, intensities, offsets), ctx.step)),
            *(ctypes.c_void_p(t.data_ptr()) for t in (lines, jitter)),
            ctypes.c_int64(len(lines)),
            _pointers(light, alpha),
            _pointers(*wanted),
            _pointers(*out),
            torch.get_num_threads(),
        )
        return (None, None, None, None, *out)


def march(
    grids: tuple[Grid, ...], lines: Tensor, jitter: Tensor, step: float, tensors: tuple[Tensor, Tensor, Tensor]
) -> Marched:
    """What rays `lines` [R, 6] (see `frustum.Rays`) meet, sampled every `step` layers from `jitter` [R] of a step on.

    `tensors`: raw densities [C], intensities [C], and offsets [h, w, d, 3] in nodes (y, x, w) at knots every KNOT
    nodes, of any size where `grids` has no second one. Differentiable in all three; float32 on the CPU.
    """
    return Marched(*_March.apply(grids, lines.contiguous(), jitter.contiguous(), step, *tensors))


def march_reference(
    grids: tuple[Grid, ...], lines: Tensor, jitter: Tensor, step: float, tensors: tuple[Tensor, Tensor, Tensor]
) -> Marched:
    """Twin of `march` in torch: any floating type, any device; every sample is read, so it takes much memory."""
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
    """Which of `places` [..., 3] have eight nodes of a grid around them."""
    last = torch.tensor(shape, device=places.device) - 1
    return ((places >= 0) & (places < last)).all(-1)


def _near(grid: Grid, places: Tensor) -> Tensor:
    """Which of `places` [..., 3] lie in a block near to cells."""
    inside = _within(places, grid.lookup.shape)
    at = torch.where(inside[..., None], places, torch.zeros_like(places)).long()
    blocks = [at[..., axis] // BLOCK[axis] for axis in range(3)]
    return inside & grid.near[tuple(blocks)].bool()


def _corners(places: Tensor) -> tuple[Tensor, Tensor]:
    """Nodes [..., 8, 3] around `places` [..., 3], and their trilinear weights [..., 8]."""
    low = places.detach().floor()
    up = torch.tensor(list(product((0, 1), repeat=3)), device=places.device)
    share = (places - low)[..., None, :]
    weights = torch.where(up.bool(), share, 1 - share).prod(-1)
    return low.long()[..., None, :] + up, weights


def _shifts(offsets: Tensor, places: Tensor) -> tuple[Tensor, Tensor]:
    """What `offsets` [h, w, d, 3] add to `places` [R, S, 3], and where they cover it [R, S]."""
    knots = places / torch.tensor(KNOT, device=places.device)
    inside = _within(knots, offsets.shape[:3])
    nodes, weights = _corners(torch.where(inside[..., None], knots, torch.zeros_like(knots)))
    return (offsets[tuple(nodes.unbind(-1))] * weights[..., None]).sum(-2), inside


def _read(grid: Grid, places: Tensor, reached: Tensor, raws: Tensor, intensities: Tensor) -> tuple[Tensor, Tensor]:
    """Optical depth of a layer and intensity [R, S] at `places` [R, S, 3], nothing where not `reached` [R, S]."""
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
