"""Defines cases 1, 12, 15 to 19 and 30 for every motion model: bounded, finite, the same at any scale."""

import math
from collections.abc import Callable

import numpy as np
import torch

from acquisition.native import code_path, code_paths
from reconstruction.gaussians.cloud import GaussianCloud
from reconstruction.gaussians.course import LEAST_DURATION, MOST_DURATION
from reconstruction.gaussians.dynamic import DynamicCloud
from reconstruction.gaussians.hexplane import HexPlaneMotion
from reconstruction.gaussians.polynomial import PolynomialMotion
from reconstruction.gaussians.rigid import knot_weights
from reconstruction.initialization.points import spacing
from reconstruction.rendering.render import render
from reconstruction.stability.case import Case, Observation, refusal
from reconstruction.stability.models import CLIP, against_float64, cloud_of, evaluated, model_names
from reconstruction.stability.probe import CAMERA, Apart, apart, worst
from reconstruction.training.exposure import passed_px

WITHIN_S = (0.0, 0.007, 0.02)
BEYOND_S = (-1e30, -1e6, -0.1, 0.5, 1e6, 1e15)
GONE = 1e-6  # opacity below which a Gaussian is not seen
LIMITED = ("opacity_logits", "log_durations")  # tensors in which infinity means always, or never
UNSEEN = ("motion.weights", "motion.distances")  # tensors of neighbours, which the loss alone reads
BOUND = 20.0  # largest length of a place, in the unit of the cloud


def _with(*names: str) -> Callable[[], tuple[str, ...]]:
    """Return a list of the models whose motion stores all the tensors `names`."""
    return lambda: tuple(n for n in model_names() if set(names) <= dict(cloud_of(n).motion.tensors()).keys())


def _worst(clouds: list[DynamicCloud], instants_s: tuple[float, ...] = WITHIN_S) -> Apart:
    return worst(against_float64(cloud, instants_s) for cloud in clouds)


def _said(count: int, error: Apart, more: str = "") -> str:
    return f"{count} clouds, {error.images:.1e} from float64{more}"


def _zero_quaternions(name: str) -> Observation:
    cloud = cloud_of(name)
    cloud.moving.quats_wxyz.zero_()
    for key, tensor in cloud.motion.tensors():
        if "quats" in key:
            tensor.zero_()
    error = _worst([cloud])
    return Observation(_said(1, error), *error)


def _few(name: str) -> Observation:
    clouds = [cloud_of(name, count=count) for count in (0, 1)]
    error = _worst(clouds)
    sizes = [len(cloud.at(0.007).means) for cloud in clouds]
    found = error.images if sizes == [0, 1] else math.inf
    return Observation(_said(2, error, f", {sizes[0]} and {sizes[1]} Gaussians"), found, error.gradients)


def _scales(name: str) -> Observation:
    plain, errors = cloud_of(name), []
    for scale in (1e-3, 2e3, 1e9):
        other = cloud_of(name, scale=scale)
        errors.append(_worst([other]))
        for instant_s in WITHIN_S:
            one, two = plain.at(instant_s), other.at(instant_s)
            gaps = (two.means / scale, one.means), (two.opacities, one.opacities), (two.quats_wxyz, one.quats_wxyz)
            errors.append(Apart(max(apart(a, b) for a, b in gaps), 0.0))
    error = worst(errors)
    return Observation(f"1e-3, 2e3 and 1e9 m: {error.images:.1e} apart", *error)


def _outside_the_box(name: str) -> Observation:
    clouds, error = [], 0.0
    for far in (2.0, 1e6, 1e20):
        cloud = cloud_of(name)
        cloud.moving.means[:] = far * BOUND * torch.tensor([1.0, -1.0, 0.5])
        clouds.append(cloud)
        if isinstance(cloud.motion, HexPlaneMotion):
            error = max(error, _unlike_the_edge(cloud))
    found = _worst(clouds)
    said = _said(3, found, ", the field as at its edge" if error else "")
    return Observation(said, max(error, found.images), found.gradients)


def _unlike_the_edge(cloud: DynamicCloud) -> float:
    """Return the error, in float64, of a field's stretch outside its box against that at the nearest edge."""
    own = cloud.to(torch.float64)
    assert isinstance(own.motion, HexPlaneMotion)
    low, high = own.motion.box
    (_, _, found, *_), _ = evaluated(own, 0.01)
    own.moving.means[:] = own.moving.means.clamp(low, high)
    (_, _, edge, *_), _ = evaluated(own, 0.01)
    return apart(found, edge)


def _body_weights(name: str) -> Observation:
    plain, clouds, error = cloud_of(name), [], 0.0
    for length in (1e-20, 1e20):
        cloud = cloud_of(name)
        for key, tensor in cloud.motion.tensors():
            if key == "knot_quats":
                tensor *= length
        clouds.append(cloud)
        error = max(error, *(apart(cloud.at(s).means, plain.at(s).means) for s in WITHIN_S))
    sound = all(bool(t.isfinite().all()) for cloud in clouds for t in evaluated(cloud, 0.007)[1])
    slope = _worst([plain]).gradients if sound else math.inf
    return Observation(f"quaternions times 1e-20 and 1e20: {error:.1e} apart", error, slope)


def _knot_weights(_: str) -> Observation:
    """Check that Catmull-Rom weights sum to one and keep even knots, so that a straight course stays straight."""
    error = 0.0
    for knots in (1, 2, 3, 17, 1000):
        for u in (-1e300, -1e-300, 0.0, 1e-16, 1 / 3, 0.5, 1 - 1e-16, 1.0, 1e300):
            weights = knot_weights(u, knots)
            straight = weights @ torch.linspace(0, 1, knots, dtype=torch.float64)
            error = max(error, abs(float(weights.sum()) - 1))
            error = max(error, abs(float(straight) - min(max(u, 0.0), 1.0)) if knots > 1 else 0.0)
    return Observation(f"1 to 1000 knots, u to 1e300: {error:.1e} off", error)


def _spacings(_: str) -> Observation:
    places, error = np.random.default_rng(4).normal(size=(200, 3)), 0.0
    gaps = np.linalg.norm(places[:, None] - places[None], axis=2)
    expected = np.sort(gaps, axis=1)[:, 1:4].mean(axis=1)
    for scale in (1e-3, 1.0, 2e3, 1e9):
        found = spacing(scale * places + 5 * scale) / scale
        error = max(error, float(np.abs(found / expected - 1).max()))
    coincident = spacing(np.ones((9, 3)))
    error = error if (coincident > 0).all() else math.inf
    return Observation(f"1e-3 to 1e9 m: {error:.1e} off, coincident ones {coincident.min():.0e} m apart", error)


def _durations(name: str) -> Observation:
    clouds, error = [], 0.0
    for log_duration in (-100.0, -3.4e38, math.log(0.3), 100.0, 3.4e38):
        cloud = cloud_of(name)
        tensors = dict(cloud.motion.tensors())
        tensors["log_durations"][:], tensors["instants"][:] = log_duration, 0.5
        clouds.append(cloud)
        lasting = math.exp(min(max(log_duration, math.log(LEAST_DURATION)), math.log(MOST_DURATION)))
        for instant_s in WITHIN_S:
            gate = math.exp(-0.5 * ((CLIP.fraction(instant_s) - 0.5) / lasting) ** 2)
            error = max(error, apart(cloud.at(instant_s).opacities, cloud.moving.opacity_logits.sigmoid() * gate))
    found = _worst(clouds)
    said = f"a Gaussian of {LEAST_DURATION:g} to {MOST_DURATION:g} clips to {error:.1e}"
    return Observation(said, max(error, found.images), found.gradients)


def _beyond_the_clip(name: str) -> Observation:
    cloud = cloud_of(name)
    found, instants = _worst([cloud], BEYOND_S), [cloud.at(instant_s) for instant_s in BEYOND_S]
    farthest = float(torch.cat([torch.zeros(1, 3), *(now.means[now.opacities > GONE] for now in instants)]).abs().max())
    said = f"at -1e30 to 1e15 s what is seen lies within {farthest:.1f}, {found.images:.1e} from float64"
    return Observation(said, found.images if farthest <= BOUND else math.inf, found.gradients)


def _refused(name: str) -> Observation:
    """Fill every tensor with NaN and infinity, but for infinity where it has a meaning; all must be refused."""
    taken, tried = [], 0
    for key, tensor in cloud_of(name).tensors():
        if not tensor.is_floating_point() or not tensor.numel() or key.endswith(UNSEEN):
            continue
        for value in (math.nan,) if key.endswith(LIMITED) else (math.nan, math.inf):
            cloud = cloud_of(name)
            dict(cloud.tensors())[key].fill_(value)
            paths = [path for path in code_paths() if _rendered(cloud, path)]
            taken += [f"{value} in {key} by {path}" for path in paths]
            tried += 1
    return Observation(f"taken: {', '.join(taken) or f'none of {tried}'}", float(len(taken)))


def _rendered(cloud: DynamicCloud, path: str) -> bool:
    """Return whether the cloud renders at every instant; a fault may lie in a single timestep."""
    with code_path(path):
        return not refusal(lambda: [render(cloud.at(instant_s), CAMERA) for instant_s in WITHIN_S])


def _passed(_: str) -> Observation:
    """Compare how far a point gets in the middle tenth of a clip, at up to 1e30 m a clip, with its path on paper."""
    error, speeds = 0.0, (0.0, 1e-30, 1e-6, 1e-3, 0.1, 1.0, 3.0, 1e3, 1e30, math.nan)
    for speed in speeds:
        point = GaussianCloud.from_points(torch.tensor([[0.0, 0.0, 2.0]]), torch.ones(1, 1), torch.zeros(1), 0.9)
        motion = PolynomialMotion.at_rest(torch.tensor([0.5]), 1e3)
        motion.velocities[:] = torch.tensor([[speed, 0.0, 0.0]])
        found = passed_px(DynamicCloud(point, point, motion, CLIP), [CAMERA], (CLIP.last_s - CLIP.first_s) / 10)
        px = CAMERA.fx * speed / 2.0 / 10
        error = max(error, abs(found - px) if px < CAMERA.width / 2 else found)
    return Observation(f"{len(speeds)} speeds, {error:.0e} px off", error)


CASES = (
    Case(1, "zero quaternions that move", "finite, as in float64", 1e-5, _zero_quaternions, model_names),
    Case(12, "no mover, and one", "as in float64", 1e-5, _few, model_names),
    Case(15, "scale of motion", "the same motion in any unit", 1e-4, _scales, model_names),
    Case(16, "points outside the box", "clamped to its edge, as in float64", 1e-5, _outside_the_box, model_names),
    Case(17, "knots of any length", "the same turn", 1e-5, _body_weights, _with("knot_quats")),
    Case(17, "weights of knots", "sum to one, straight stays straight", 1e-12, _knot_weights),
    Case(17, "nearest neighbours", "the same spacing in any unit, above zero", 1e-5, _spacings),
    Case(18, "durations of 0 and infinity", "a floor and a ceiling", 1e-5, _durations, _with("log_durations")),
    Case(19, "far outside the clip", "bounded or gone, as in float64", 1e-5, _beyond_the_clip, model_names),
    Case(None, "how far a mover gets", "its path on paper, nowhere where it leaves the picture", 1e-3, _passed),
    Case(30, "NaN and infinity that move", "refused by cloud or renderer", 0.0, _refused, model_names),
)
