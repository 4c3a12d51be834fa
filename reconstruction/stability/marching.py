"""Defines the cases of radiance fields: densities, light, offsets and rays at their limits, on each kernel build."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from reconstruction.radiance_fields.march import Grid, march, march_reference
from reconstruction.radiance_fields.radiance_field import REACH, grid_of
from reconstruction.stability.case import Case, Observation
from reconstruction.stability.probe import Apart, apart, natives, running, slopes_of, worst

SHAPE = (20, 24, 12)  # rows, columns, layers
STILL, MOVING, RAYS = 2500, 1500, 61
OUTSIDE = (1e9, -1e9, 3e38, math.nan, math.inf)
EDGE = 100.0  # raw density of neighbours, of either sign; float32 keeps 1e-7 of it


@dataclass(frozen=True, eq=False)
class March:
    """The arguments of one march: cells that stand still, cells that move, and rays that cross them at random."""

    grids: tuple[Grid, ...]
    lines: Tensor
    jitter: Tensor
    raws: Tensor
    intensities: Tensor
    offsets: Tensor


def _march(still: int = STILL, moving: int = MOVING, rays: int = RAYS) -> March:
    generator = torch.Generator().manual_seed(5)
    order = torch.randperm(math.prod(SHAPE), generator=generator)
    nodes = order[:still].sort().values, order[still : still + moving].sort().values
    grids = (grid_of(nodes[0], 0, SHAPE, (0, 0, 0)), grid_of(nodes[1], still, SHAPE, REACH))
    x, y, dx, dy, stretch, first, jitter = torch.rand(7, rays, generator=generator)
    lines = torch.stack([23 * x, 19 * y, dx - 0.5, dy - 0.5, 1 + 0.2 * stretch, 2 * first], dim=1)
    raws = torch.randn(still + moving, generator=generator) - 2
    offsets = 0.7 * torch.randn(3, 3, 3, 3, generator=generator)
    return March(grids, lines, jitter, raws, torch.rand(still + moving, generator=generator), offsets)


def marchers() -> tuple[str, ...]:
    """Return the readable twin in float32, and the kernel by each code path of this processor."""
    return ("reference", *natives())


def _marched(asked: March, marcher: str, dtype: torch.dtype) -> tuple[tuple[Tensor, ...], tuple[Tensor, ...]]:
    """Return light and alpha, and the gradients of their uneven sum by the three tensors, in float64."""
    tensors = asked.raws, asked.intensities, asked.offsets
    raws, intensities, offsets = leaves = [t.to(dtype).clone().requires_grad_() for t in tensors]
    with running(marcher) as backend:
        marching = march_reference if backend == "reference" else march
        seen = marching(asked.grids, asked.lines, asked.jitter, 1.0, (raws, intensities, offsets))
        weights = torch.linspace(-1, 1, len(seen.light), dtype=dtype)
        (seen.light * weights + seen.alpha * weights.flip(0)).sum().backward()
    return (seen.light.detach().double(), seen.alpha.detach().double()), slopes_of(leaves)


def _against_float64(cases: list[March], marcher: str) -> Observation:
    """Compare light, alpha and gradients with the twin's in float64."""
    errors = []
    for asked in cases:
        (found, slopes), (expected, steep) = (
            _marched(asked, *how) for how in ((marcher, torch.float32), ("reference", torch.float64))
        )
        errors.append(Apart.of(found, expected, slopes, steep))
    error, slope = worst(errors)
    return Observation(f"{len(cases)} marches, worst {error:.1e} from float64", error, slope)


def _all(value: float) -> Tensor:
    return torch.full((STILL + MOVING,), value)


def _densities() -> list[March]:
    mixed = torch.where(torch.arange(STILL + MOVING) % 2 == 0, _all(EDGE), _all(-EDGE))
    values = [_all(value) for value in (-3e38, -100.0, 0.0, 15.0, 100.0, 3e38)]
    return [replace(_march(), raws=raws) for raws in (*values, mixed)]


def _lights() -> list[March]:
    return [replace(_march(), intensities=_all(value)) for value in (0.0, 1e-30, 1e15, -1.0)]


def _offsets() -> list[March]:
    return [replace(_march(), offsets=torch.full((3, 3, 3, 3), value)) for value in (0.0, 1e4, -1e30)]


def _sizes() -> list[March]:
    sizes = ((0, 0, 5), (1, 0, 5), (0, 1, 5), (STILL, MOVING, 0), (STILL, MOVING, 1), (STILL, MOVING, 7))
    return [_march(*size) for size in sizes]


def _strays(marcher: str) -> Observation:
    """Lead every ray of a march but the first astray in one number each; the first must stay as it is alone."""
    usual = _march(rays=1)
    stray = usual.lines.repeat(1 + 4 * len(OUTSIDE), 1)
    for row, (column, value) in enumerate(((c, v) for c in (0, 1, 2, 3) for v in OUTSIDE), start=1):
        stray[row, column] = value
    asked = replace(usual, lines=stray, jitter=usual.jitter.repeat(len(stray)))
    (light, alpha), slopes = _marched(asked, marcher, torch.float32)
    own, _ = _marched(usual, marcher, torch.float32)
    seen = torch.cat([light[1:], alpha[1:]]).abs().max()
    error = max(float(seen), apart(light[:1], own[0]), apart(alpha[:1], own[1]))
    finite = all(bool(slope.isfinite().all()) for slope in slopes)
    return Observation(f"{len(stray) - 1} rays, light {float(seen):.0e}", error if finite else math.inf)


def _case(name: str, expected: str, marches: Callable[[], list[March]]) -> Case:
    return Case(None, f"field: {name}", expected, 1e-4, lambda on: _against_float64(marches(), on), marchers)


CASES = (
    _case("raw densities to +-3e38, edges of +-100", "nothing or a wall, as in float64", _densities),
    _case("light of 0, 1e-30, 1e15 and below 0", "as in float64", _lights),
    _case("offsets that lead out of the grid", "nothing there, as in float64", _offsets),
    Case(None, "field: rays that miss, or are no numbers", "no light; others as before", 0.0, _strays, marchers),
    _case("no cell, one cell, no ray, one, seven", "as in float64", _sizes),
)
