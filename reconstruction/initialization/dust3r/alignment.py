"""Many pairs, each in a frame and at a scale of its own, to one world: poses and depths for all views.

Letters: v views, e pairs, n sampled pixels of each view. A view's points are its rays times their depths, carried by
its pose; a pair's points are carried by its similarity; the sum over all pairs of the distance between the two, times
the logarithm of the network's confidence, is made as small as possible. Distances count linearly, so that what is wrong
in some pairs is outvoted; they are rounded off near zero, less from stage to stage.
Method: L-BFGS, double precision; each group of unknowns is measured in steps of about equal effect.
Source: Wang et al., "DUSt3R: geometric 3D vision made easy", CVPR 2024, section 3.4 (which uses Adam).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from acquisition.progress import Progress, silent
from reconstruction.errors import GeometryError
from reconstruction.initialization.dust3r.start import PairMaps, Start, started
from reconstruction.networks.msdi.views import cross_matrices
from rigs.transform import Floats, Transform

ROUNDED = (0.05, 0.01, 0.002)  # distances, in median depths, below which squares count; stage by stage
STEPS = 100  # most steps of a stage
POLISHED = 3  # times: L-BFGS may stop on its way, and goes on when begun anew
CAUCHY = 3.0  # width of the last stage, in median distances
FINEST = 1e-6  # least median distance, in median depths
MOST_RESIDUAL = 0.15  # median disagreement of a view with its pairs, as a share of the depth
AGREEMENT = 0.05  # as a share of the depth: where a point's confidence has fallen to half


@dataclass(frozen=True, eq=False)
class Aligned:
    """Views in one world, whose unit is arbitrary.

    `points` [v, n, 3] have a `confidence` [v, n] >= 0; `residuals` [v] are the median disagreement with the pairs, as a
    share of the depth.
    """

    cam_from_world: tuple[Transform, ...]
    points: Floats
    confidence: Floats
    residuals: Floats


def aligned(names: Sequence[str], rays: Floats, pairs: Sequence[PairMaps], progress: Progress = silent) -> Aligned:
    """Lay all `pairs` of the views `names` on one another; `rays` [v, n, 2] are x / z and y / z of the sampled pixels.

    Raises GeometryError naming the views that overlap with no other, or on which the pairs do not agree.
    """
    progress(0.0, "first poses")
    problem = _Problem(rays, pairs, started(names, rays, pairs))
    for stage, rounded in enumerate(ROUNDED):
        progress((stage + 1) / (len(ROUNDED) + 1), "aligning pairs")
        problem.improve(rounded)
    for _ in range(POLISHED):
        problem.polish()
    progress(1.0, "aligned")
    found = problem.result()
    bad = [name for name, off in zip(names, found.residuals, strict=True) if not off <= MOST_RESIDUAL]
    if bad:
        worst = 100 * float(np.nanmax(found.residuals))
        disagreement = f"found pairs that disagree on {', '.join(bad)} by {worst:.0f}% of the depth"
        most = f"less than {100 * MOST_RESIDUAL:.0f}%"
        raise GeometryError(disagreement, most, "leave them out or give clearer images")
    return found


class _Problem:
    """The unknowns, as changes from the start, and what they cost."""

    def __init__(self, rays: Floats, pairs: Sequence[PairMaps], start: Start):
        poses, similarities = start.cam_from_world, start.world_from_pair
        depths = np.stack([pose.apply(cloud)[:, 2] for pose, cloud in zip(poses, start.points, strict=True)])
        weights = np.stack([pair.weights for pair in pairs])
        sides = np.array([[pair.first, pair.second] for pair in pairs])
        ahead = np.where(depths > 0, depths, np.nan)
        middle = np.nanmedian(ahead, axis=1, keepdims=True)  # for pixels that no tree edge puts ahead of their camera
        self._unit = float(np.median(middle))
        depths = np.clip(np.where(depths > 0, depths, middle), 0.05 * middle, 20 * middle)
        self._rays, self._sides = torch.from_numpy(rays), torch.from_numpy(sides)
        self._points = torch.from_numpy(np.stack([pair.finite_points for pair in pairs]))
        self._weights = torch.from_numpy(weights / weights.sum())
        self._turns = torch.from_numpy(np.stack([pose.rotation.T for pose in poses]))  # world_from_cam
        self._centers = torch.from_numpy(np.stack([pose.center for pose in poses]) / self._unit)
        self._log_depths = torch.from_numpy(np.log(depths / self._unit))
        self._pair_turns = torch.from_numpy(np.stack([s.rotation for s in similarities]))
        self._pair_shifts = torch.from_numpy(np.stack([s.translation for s in similarities]) / self._unit)
        self._log_scales = torch.log(torch.tensor([s.scale for s in similarities], dtype=torch.float64) / self._unit)
        v, n, e = *rays.shape[:2], len(pairs)
        shapes = ((v, 3), (v, 3), (v, n), (e, 3), (e, 3), (e,))
        self._changes = [torch.zeros(shape, dtype=torch.float64, requires_grad=True) for shape in shapes]
        self._steps = [v**0.5, v**0.5, (v * n) ** 0.5, e**0.5, e**0.5, e**0.5]

    def _world(self) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Return world_from_cam [v, 3, 3], centres [v, 3], depths [v, n] and points [v, n, 3] of the unknowns."""
        turn, shift, deeper, *_ = (c * step for c, step in zip(self._changes, self._steps, strict=True))
        turns = self._turns @ torch.linalg.matrix_exp(cross_matrices(turn))
        depths = torch.exp(self._log_depths + deeper)
        in_cam = torch.cat([self._rays, torch.ones_like(self._rays[..., :1])], dim=-1) * depths[..., None]
        centers = self._centers + shift
        return turns, centers, depths, in_cam @ turns.mT + centers[:, None]

    def _apart(self, points: Tensor) -> Tensor:
        """Return the squared distances [e, 2, n] of each pair's points from the views' points."""
        *_, turn, shift, larger = (c * step for c, step in zip(self._changes, self._steps, strict=True))
        turns = self._pair_turns @ torch.linalg.matrix_exp(cross_matrices(turn))
        fixed = larger - larger.mean()  # or all would shrink to nothing
        scales = torch.exp(self._log_scales + fixed)[:, None, None, None]
        said = scales * (self._points @ turns.mT[:, None]) + (self._pair_shifts + shift)[:, None, None]
        return (said - points[self._sides]).square().sum(dim=-1)

    def improve(self, rounded: float) -> None:
        """Take some steps down; distances below `rounded` count as squares, those above as they are."""
        self._descend(lambda squared: torch.sqrt(squared + rounded**2) - rounded)

    def polish(self) -> None:
        """Take some steps down; distances far above the usual one count next to nothing (Cauchy)."""
        with torch.no_grad():
            squared = self._apart(self._world()[3])
            usual = max(float(squared[self._weights > 0].median()) ** 0.5, FINEST)
        self._descend(lambda squared: usual * torch.log1p(squared / (CAUCHY * usual) ** 2))

    def _descend(self, loss: Callable[[Tensor], Tensor]) -> None:
        optimizer = torch.optim.LBFGS(
            self._changes,
            max_iter=STEPS,
            history_size=20,
            line_search_fn="strong_wolfe",
            tolerance_grad=1e-10,
            tolerance_change=1e-9,
        )

        def cost() -> Tensor:
            optimizer.zero_grad()
            total = (self._weights * loss(self._apart(self._world()[3]))).sum()
            total.backward()
            return total

        optimizer.step(cost)  # pyright: ignore[reportArgumentType]

    @torch.no_grad()
    def result(self) -> Aligned:
        """Return the views as they are now."""
        turns, centers, depths, points = self._world()
        if not bool(torch.isfinite(points).all()):
            raise GeometryError("found an alignment that ran away", "finite poses", "give clearer images")
        shares = self._apart(points).sqrt() / depths[self._sides]
        v, n = depths.shape
        weights = self._weights * (self._weights.numel() / self._weights.sum())
        support = torch.zeros(v, n, dtype=torch.float64)
        support.index_add_(0, self._sides.ravel(), (weights / (1 + (shares / AGREEMENT) ** 2)).flatten(0, 1))
        seen = [(self._sides == view)[..., None] & (self._weights > 0) for view in range(v)]
        residuals = [float(shares[mine].median()) for mine in seen]
        u, _, vt = np.linalg.svd(turns.numpy())  # rounding has left them nearly rotations
        poses = [Transform(r.T, -r.T @ c) for r, c in zip(u @ vt, centers.numpy(), strict=True)]
        return Aligned(tuple(poses), points.numpy(), support.numpy(), np.array(residuals))
