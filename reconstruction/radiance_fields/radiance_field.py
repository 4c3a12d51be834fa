"""A radiance field: grey light and density in cells around surfaces, some of them moved by a deformation.

Sources: Zhu et al., "SpikeNeRF", CVPR 2024 (a radiance field learnt from spikes); Fridovich-Keil et al., "Plenoxels",
CVPR 2022 (sparse cells in place of a network); Pumarola et al., "D-NeRF", CVPR 2021 (one canonical space and a
deformation into it); the deformation is that of 4DGS (`gaussians.hexplane`). Ours: the grid (`frustum`), cells only
around points of the sweep, still cells beside the deformed ones, and a deformation that is evaluated at knots of space
and linear between them. Letters: N still and M moving cells, h, w, d knots along y, x and w.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import softplus

from reconstruction.errors import ReconstructionError
from reconstruction.gaussians.hexplane import FieldShape, HexPlaneMotion
from reconstruction.radiance_fields.frustum import Frustum
from reconstruction.radiance_fields.march import BLOCK, KNOT, STEP, Grid, march
from reconstruction.rendering.bent import seen_through
from reconstruction.scene_model import Rate, TimeSpan, View, gain_at
from rigs.camera import Camera

REACH = (3, 3, 2)  # blocks around moving cells within which the deformation may lead to them


class ShiftField(HexPlaneMotion):
    """The field of 4DGS with a head for positions alone; its box is in nodes (y, x, w)."""

    kind = "shift"
    shape = FieldShape(heads=1)


@dataclass
class RadianceField:
    """Cells at the nodes `still` [N] and `moving` [M] int32, flat and sorted; see `scene_model.SceneModel`.

    `densities` [N + M] are raw, as `march` reads them; `intensities` [N + M] are in spikes per tick. `shifts` says
    where moving samples are read; it is None where nothing moves.
    """

    frustum: Frustum
    still: Tensor
    moving: Tensor
    densities: Tensor
    intensities: Tensor
    shifts: ShiftField | None
    clip: TimeSpan
    light: Tensor = field(default_factory=lambda: torch.ones(1))
    unit: ClassVar[str] = "cells"
    kind: ClassVar[str] = "field"  # the name in a checkpoint

    def __post_init__(self) -> None:
        parts = [grid_of(self.still, 0, self.frustum.shape, (0, 0, 0))]
        if len(self.moving):
            parts.append(grid_of(self.moving, len(self.still), self.frustum.shape, REACH))
        self.grids, self.nodes = tuple(parts), torch.cat([self.still, self.moving])
        self.last = parts[0].lookup.numel() - 1
        self.knots = tuple(-(-size // knot) + 1 for size, knot in zip(self.frustum.shape, KNOT, strict=True))

    def __len__(self) -> int:
        return len(self.still) + len(self.moving)

    @property
    def networks(self) -> bool:
        """Tell that a step has large operations of torch: grids are read along rays."""
        return True

    def tensors(self) -> Iterator[tuple[str, Tensor]]:
        """Yield every tensor with its name."""
        for name in ("densities", "intensities"):
            yield f"field.{name}", getattr(self, name)
        for name, tensor in self.shifts.tensors() if self.shifts else ():
            yield f"shifts.{name}", tensor

    def at(self, instant_s: float) -> tuple[Tensor, Tensor, Tensor]:
        """Return densities, intensities and offsets [h, w, d, 3] at an instant, as `march` takes them."""
        u = self.clip.fraction(instant_s)
        intensities = self.intensities
        if len(self.light) > 1:
            intensities = intensities * gain_at(self.light, u)
        if self.shifts is None:
            return self.densities, intensities, torch.zeros(1, 1, 1, 3)
        knots = torch.cartesian_prod(*(torch.arange(n) * k for n, k in zip(self.knots, KNOT, strict=True)))
        low, high = self.shifts.box
        shift = self.shifts.offsets(self.shifts.places(knots.float()), min(max(u, 0.0), 1.0)).shift
        return self.densities, intensities, (shift * (high - low) / 2).view(*self.knots, 3)

    def positions(self, instant_s: float) -> Tensor:
        """Return the nodes of all cells [N + M, 3] in m in the rig frame, the same at any instant."""
        nodes = torch.stack(torch.unravel_index(self.nodes.long(), self.frustum.shape), 1)
        return torch.from_numpy(self.frustum.positions(nodes.double().numpy())).float()

    def movers(self, instant_s: float) -> tuple[Tensor, Tensor]:
        """Return empty positions [0, 3] and opacities [0]: no cell leaves its place."""
        return torch.zeros(0, 3), torch.zeros(0)

    def look(self, camera: Camera, instant_s: float) -> View:
        """Return what `camera` sees at `instant_s` on the rig clock, through its lens."""
        return seen_through(camera, lambda pinhole: self._looked(pinhole, instant_s))

    def _looked(self, camera: Camera, instant_s: float) -> View:
        rows, columns = np.indices((camera.height, camera.width)).reshape(2, -1)
        rays = self.frustum.rays(camera, columns, rows)
        with torch.no_grad():
            seen = march(self.grids, rays.lines, torch.full((len(rays),), 0.5), STEP, self.at(instant_s))
        depth = self.frustum.depths(rays, seen.middle)
        return View(*(image.view(camera.height, camera.width).numpy() for image in (seen.light, depth)))

    def to(self, kind: torch.dtype | torch.device) -> RadianceField:
        """Return the field itself, in its only form; raises ReconstructionError for another."""
        if kind not in (torch.float32, torch.device("cpu")):
            raise ReconstructionError(f"found a radiance field asked for as {kind}", "float32 on the CPU")
        return self

    def rates(self) -> Mapping[str, Rate]:
        """Return the learning rate of every tensor that is learnt, by name."""
        own = {"field.densities": Rate(0.3), "field.intensities": Rate(8e-3, "light")}
        return own | {f"shifts.{kind}": rate for kind, rate in ShiftField.rates.items() if self.shifts}

    def advance(self, done: float) -> float:
        """Return `done`: a field is trained in one stage."""
        return done

    def penalty(self) -> Tensor | None:
        """Return the regulariser of the deformation, None where nothing moves."""
        return self.shifts.roughness() if self.shifts else None

    def variation(self, cells: Tensor) -> Tensor:
        """Return the mean absolute difference of `cells` [K] int64 to their neighbours; raw densities count a tenth."""
        _, columns, layers = self.frustum.shape
        beside = (self.nodes[cells].long() + torch.tensor([[columns * layers], [layers], [1]])).clamp_max(self.last)
        others = [grid.lookup.view(-1)[beside] for grid in self.grids]
        other = others[0] if len(others) == 1 else torch.where(cells < len(self.still), *others)
        pairs = torch.cat([cells.expand(3, -1).reshape(-1), other.long().clamp_min(0).view(-1)])
        there, total = (other >= 0).view(-1).to(self.densities), torch.zeros(())
        for values, weight in ((self.densities, 0.1), (self.intensities, 1.0)):
            own, next_to = values.index_select(0, pairs).view(2, -1)  # one read: each costs a gradient of all cells
            total = total + weight * (there * (own - next_to).abs()).sum() / len(cells)
        return total

    def opacity(self) -> Tensor:
        """Return the share of the light that each cell takes, [N + M] in 0 to 1, without gradients."""
        return 1 - torch.exp(-softplus(self.densities.detach()))

    def state(self) -> dict[str, Any]:
        """Return tensors, numbers and names, for a checkpoint."""
        return {
            "model": self.kind,
            "clip": [self.clip.first_s, self.clip.last_s],
            "frustum": asdict(self.frustum),
            **{name: getattr(self, name).detach().clone() for name in ("light", "still", "moving")},
            "tensors": {k: v.detach().clone() for k, v in self.tensors()},
        }

    @classmethod
    def from_state(cls, state: dict) -> RadianceField:
        """Return the field whose `state` this is; raises ReconstructionError for tensors it does not know."""
        try:
            parts: dict[str, dict[str, Tensor]] = {"field": {}, "shifts": {}}
            for name, tensor in state["tensors"].items():
                part, kind = name.split(".")
                parts[part][kind] = tensor
            shifts = ShiftField(**parts["shifts"]) if parts["shifts"] else None
            kept = parts["field"] | {name: state[name] for name in ("light", "still", "moving")}
            return cls(frustum=Frustum(**state["frustum"]), clip=TimeSpan(*state["clip"]), shifts=shifts, **kept)
        except (KeyError, TypeError, ValueError) as error:
            found = f"found a field with {', '.join(state.get('tensors', {})) or 'no tensors'}"
            raise ReconstructionError(found, "one as this version stores it", "train again") from error


def grid_of(nodes: Tensor, first: int, shape: tuple[int, int, int], reach: tuple[int, int, int]) -> Grid:
    """Return the grid of `shape` with cells numbered from `first` on at flat `nodes`, met within `reach` blocks."""
    lookup = torch.full(shape, -1, dtype=torch.int32)
    lookup.view(-1)[nodes.long()] = torch.arange(first, first + len(nodes), dtype=torch.int32)
    blocks = [-(-size // block) for size, block in zip(shape, BLOCK, strict=True)]
    near = torch.zeros(1, 1, *blocks)
    places = torch.unravel_index(nodes.long(), shape)
    for back in range(8):  # a cell is read by samples between its node and the one before
        before = [(at - (back >> axis & 1)).clamp_min(0) // BLOCK[axis] for axis, at in enumerate(places)]
        near[0, 0][tuple(before)] = 1
    if any(reach):
        kernel = tuple(2 * r + 1 for r in reach)
        near = torch.nn.functional.max_pool3d(near, kernel, stride=1, padding=reach)
    return Grid(lookup, near[0, 0].to(torch.uint8).contiguous())
