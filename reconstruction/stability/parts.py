"""Defines cases of bodies that are cut into parts and joined again: in any unit, of any shape, with any riders."""

from dataclasses import replace

import torch
from torch import Tensor

from reconstruction.gaussians.cloud import GaussianCloud
from reconstruction.gaussians.dynamic import DynamicCloud
from reconstruction.gaussians.parts import RIDERS, joined, parted
from reconstruction.gaussians.rigid import RigidMotion
from reconstruction.scene_model import TimeSpan
from reconstruction.stability.case import Case, Observation

CLIP, KNOTS = TimeSpan(0.0, 0.02), 9
UNITS = (1e-3, 1.0, 1e3, 1e6)
FLAT = ((1, 1, 1), (1, 1, 0), (1, 0, 0), (0, 0, 0))  # a block, a sheet, a rod, a point
COUNTS = (1, 2, 3, 7, RIDERS, RIDERS + 1, 2 * RIDERS + 3, 5000)
TOLERANCE = 1e-4  # of the body's length, in float32
TURN_RAD = 1.2


def _units(_: str) -> Observation:
    """Join two bars, of which the second may turn, in every unit; the error is in their length, or a wrong number."""
    error = 0.0
    for unit in UNITS:
        for turn_rad in (0.0, TURN_RAD):
            places = unit * _places(2 * RIDERS, (1, 0.2, 0.2))
            cut = parted(_body(places, torch.zeros(1)))
            motion = _bodies(cut)
            angles = torch.where(motion.knot_centers[:, 0, 0] > 0, turn_rad, 0.0)
            hinged = replace(cut, motion=replace(motion, knot_quats=_turning(angles)))
            error = max(error, _apart(hinged, joined(hinged, 0.01 * unit), 2 if turn_rad else 1) / unit)
    return Observation(f"{len(UNITS)} units, 1 mm to 1,000 km: {error:.1e} lengths apart", error)


def _shapes(_: str) -> Observation:
    """Cut bodies of every shape and number of riders and join them; the error is in their length, or a wrong number."""
    error = 0.0
    for flat in FLAT:
        for count in COUNTS:
            whole = _body(_places(count, flat), torch.tensor([TURN_RAD]))
            cut = parted(whole)
            error = max(error, _apart(whole, cut, len(_bodies(cut).knot_quats)), _apart(cut, joined(cut, 0.01), 1))
    return Observation(f"{len(FLAT)} shapes, 1 to {COUNTS[-1]:,} riders: {error:.1e} lengths apart", error)


def _apart(before: DynamicCloud, after: DynamicCloud, bodies: int) -> float:
    """Return how far Gaussians are from where they were at the knots, in m; infinity for any other number of bodies."""
    if len(_bodies(after).knot_quats) != bodies:
        return float("inf")
    instants = [CLIP.instant_s(i / (KNOTS - 1)) for i in range(KNOTS)]
    return max(float((before.movers(s)[0] - after.movers(s)[0]).norm(dim=1).amax()) for s in instants)


def _bodies(cloud: DynamicCloud) -> RigidMotion:
    assert isinstance(cloud.motion, RigidMotion)
    return cloud.motion


def _places(count: int, extents: tuple[float, ...]) -> Tensor:
    places = torch.rand(count, 3, generator=torch.Generator().manual_seed(0)) - 0.5
    return places * torch.tensor(extents)


def _turning(angles_rad: Tensor) -> Tensor:
    """Return quaternions [K, KNOTS, 4] of bodies that turn about z by these angles [K] from the middle of the clip."""
    halves = angles_rad[:, None] * torch.linspace(-0.25, 0.25, KNOTS)
    none = torch.zeros_like(halves)
    return torch.stack([halves.cos(), none, none, halves.sin()], dim=-1)


def _body(places: Tensor, angles_rad: Tensor) -> DynamicCloud:
    """Return one body with a rider at each of the places [A, 3] in m, which turns about the origin."""
    n = len(places)
    riders = GaussianCloud.from_points(places, torch.full((n, 1), 0.3), torch.full((n,), -4.0), 0.6)
    none = GaussianCloud.from_points(torch.zeros(0, 3), torch.zeros(0, 1), torch.zeros(0), 0.6)
    bodies, centers = torch.zeros(n, dtype=torch.int64), torch.zeros(1, KNOTS, 3)
    motion = RigidMotion(
        bodies, _turning(angles_rad), centers, torch.zeros(0, 3), torch.full((n,), 0.5), torch.zeros(n)
    )
    return DynamicCloud(none, riders, motion, CLIP)


CASES = (
    Case(None, "parts that move as one, or not", "joined where they do, in any unit", TOLERANCE, _units),
    Case(None, "bodies of any shape", "cut and joined, where they were", TOLERANCE, _shapes),
)
