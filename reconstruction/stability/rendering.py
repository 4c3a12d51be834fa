"""Cases 1 to 15 of the catalogue: Gaussians no renderer likes."""

import math

import torch

from reconstruction.rendering.render import Backend
from reconstruction.stability.case import Case, Observation
from reconstruction.stability.probe import Gaussians, against_reference, apart, gaussians_of, probe


def _worst(cases: list[Gaussians], backend: Backend, **options: float) -> Observation:
    errors = [against_reference(gaussians, backend, **options)[1] for gaussians in cases]
    return f"{len(cases)} renderings, worst {max(errors):.1e} from float64", max(errors)


def _zero_quaternion(backend: Backend) -> Observation:
    scales = torch.tensor([[-2.0, -3.0, -4.0]])
    found, error = against_reference(gaussians_of(quats_wxyz=torch.zeros(1, 4), log_scales=scales), backend)
    identity = probe(gaussians_of(log_scales=scales), backend)
    turn = float(found.gradients[1].abs().max())
    error = max(error, apart(found.rendering.intensity, identity.rendering.intensity), turn)
    return f"the identity to {error:.1e}, gradient {turn:.0e}", error


def _long_quaternions(backend: Backend) -> Observation:
    quats, scales = torch.tensor([[0.8, 0.1, -0.5, 0.3]]), torch.tensor([[-2.0, -3.0, -4.0]])
    unit = probe(gaussians_of(quats_wxyz=quats, log_scales=scales), backend).rendering.intensity
    found = [
        probe(gaussians_of(quats_wxyz=quats * length, log_scales=scales), backend) for length in (1e20, 1e-20, 1e-3)
    ]
    error = max(apart(f.rendering.intensity, unit) if f.sound else math.inf for f in found)
    return f"lengths 1e20, 1e-20, 1e-3: {error:.1e} apart", error


def _endless_scales(backend: Backend) -> Observation:
    clouds = [gaussians_of(log_scales=torch.full((1, 3), s)) for s in (100.0, -100.0, 20.0, 3e38, -3e38)]
    slope = max(float(probe(cloud, backend).gradients[2].abs().max()) for cloud in clouds)
    covered = [float(probe(cloud, backend).rendering.alpha.mean()) for cloud in clouds]
    cover = max(abs(c - e) for c, e in zip(covered, (0.7, 0, 0.7, 0.7, 0), strict=True))
    said, error = _worst(clouds, backend)
    return f"{said}, gradient {slope:.0e}", max(error, slope, cover)


def _needles(backend: Backend) -> Observation:
    clouds, thin = [], True
    for degrees in (0.0, 17.0, 45.0, 90.0):
        half = math.radians(degrees) / 2
        quats = torch.tensor([[math.cos(half), 0, 0, math.sin(half)]])
        for ratio in (1e2, 1e4):
            width = math.log(0.3) - math.log(ratio) / 2
            clouds.append(
                gaussians_of(quats_wxyz=quats, log_scales=torch.tensor([[width + math.log(ratio), width, width]]))
            )
            scales = torch.tensor([[math.log(0.3), *[math.log(0.3 / ratio)] * 2]])
            thin = thin and probe(gaussians_of(quats_wxyz=quats, log_scales=scales), backend).sound
    said, error = _worst(clouds, backend)
    return said, error if thin else math.inf


def _below_a_pixel(backend: Backend) -> Observation:
    energies = []
    for scale in (0.02, 0.01, 0.005):  # 0.6, 0.3, 0.15 px
        found, error = against_reference(gaussians_of(log_scales=torch.full((1, 3), math.log(scale))), backend)
        whole = 2 * math.pi * 0.7 * (60 * scale / 2) ** 2
        energies.append(float(found.rendering.alpha.sum()) / whole if error < 1e-3 else math.inf)
    said = ", ".join(f"{e:.2f}" for e in energies)
    return f"{said} of the energy at 0.6, 0.3, 0.15 px", max(abs(e - 1) for e in energies)


def _over_the_image(backend: Backend) -> Observation:
    found, error = against_reference(gaussians_of(log_scales=torch.full((1, 3), 3.0)), backend)
    least = float(found.rendering.alpha.min())
    return f"alpha {least:.4f} at least, radius {int(found.rendering.radii[0])} px", max(error, abs(least - 0.7))


def _near_plane(backend: Backend) -> Observation:
    near = torch.tensor(0.25)
    before = torch.nextafter(near, torch.tensor(0.0))
    seen, error = against_reference(gaussians_of(means=torch.tensor([[0.0, 0.0, 0.25]])), backend, near_m=0.25)
    for z in (float(before), 0.0, -0.0, -1.0, 1e-30, -3e38):
        hidden = probe(gaussians_of(means=torch.tensor([[0.001, 0.001, z]])), backend, near_m=0.25)
        light = float(hidden.rendering.alpha.max()) + sum(float(g.abs().max()) for g in hidden.gradients)
        error = max(error, light if hidden.sound else math.inf)
    error = error if int(seen.rendering.radii[0]) > 0 else math.inf
    return f"seen at the plane, dark before and behind it, to {error:.1e}", error


def _off_the_axis(backend: Backend) -> Observation:
    clouds = []
    for x in (0.7, 1.0, 3.0, 100.0, 1e20):
        clouds.append(gaussians_of(means=torch.tensor([[x, 0.1, 2.0]]), log_scales=torch.full((1, 3), -0.5)))
        clouds.append(gaussians_of(means=torch.tensor([[x, 0.1, 0.02]])))
    return _worst(clouds, backend)


def _endless_logits(backend: Backend) -> Observation:
    error, most = 0.0, 0.0
    for logit in (100.0, -100.0, 30.0, -30.0):
        logits = torch.full((1,), logit, requires_grad=True)
        found, apart_here = against_reference(gaussians_of(opacities=logits.sigmoid()), backend)
        (slope,) = torch.autograd.grad(logits.sigmoid().sum(), logits)
        error = max(error, apart_here if bool(slope.isfinite().all()) else math.inf)
        most = max(most, float(found.rendering.alpha.max()))
    cap = 0.999 if backend == "gsplat" else 0.99
    return f"alpha at most {most:.4f}", max(error, 0.0 if most <= cap + 1e-6 else math.inf)


def _stacked(backend: Backend) -> Observation:
    depths = torch.linspace(1.0, 3.0, 1000)
    means = torch.stack([depths * 0.25 / 30, depths * 0.25 / 30, depths], 1)
    error, steepest = 0.0, 0.0
    for opacity in (0.999, 0.5):
        cloud = gaussians_of(1000, means=means, opacities=torch.full((1000,), opacity))
        found, apart_here = against_reference(cloud, backend)
        error = max(error, apart_here, 1 - float(found.rendering.alpha[14, 20]))
        steepest = max(steepest, *(float(g.abs().max()) for g in found.gradients))
    return f"{error:.1e} from float64, gradients below {steepest:.1e}", error if steepest < 1e6 else math.inf


def _transmittance(backend: Backend) -> Observation:
    faint = torch.rand(2000, generator=torch.Generator().manual_seed(0)) / 100
    return _worst([gaussians_of(2000, opacities=faint)], backend)


def _nothing(backend: Backend) -> Observation:
    beside = gaussians_of(3, means=torch.tensor([[50.0, 0, 2], [0, -50, 2], [0, 0, -2]]))
    found = [probe(cloud, backend, background=0.25) for cloud in (gaussians_of(0), beside)]
    light = max(apart(f.rendering.intensity, torch.tensor(0.25)) for f in found)
    slope = max(float(g.abs().max()) for g in found[1].gradients)
    return f"the background to {light:.0e}, gradient {slope:.0e}", max(light, slope)


def _equal_depths(backend: Backend) -> Observation:
    cloud = gaussians_of(3, intensities=torch.tensor([[1.0], [2.0], [3.0]]))
    found, again = (probe(cloud, backend).rendering.intensity for _ in range(2))
    a = 0.7 * 9 / 9.3  # what the dilation of 0.3 px^2 leaves of 9 px^2
    expected = a * 1 + (1 - a) * a * 2 + (1 - a) ** 2 * a * 3
    error = max(abs(float(found[14, 20, 0]) - expected), apart(found, again))
    return f"in the order given, twice the same, to {error:.1e}", error


def _all_dead(backend: Backend) -> Observation:
    found = probe(gaussians_of(5, opacities=torch.zeros(5)), backend)
    light = float(found.rendering.alpha.max()) + max(float(g.abs().max()) for g in found.gradients)
    return f"{int((found.rendering.radii > 0).sum())} seen, light and gradient {light:.0e}", light


def _units(backend: Backend) -> Observation:
    means, quats, log_scales, opacities, intensities = gaussians_of()
    plain = probe(gaussians_of(), backend).rendering.intensity
    error = 0.0
    for size in (1e-3, 1.0, 2e3):
        scaled = (means * size, quats, log_scales + math.log(size), opacities, intensities)
        found, apart_here = against_reference(scaled, backend, near_m=0.01 * size)
        error = max(error, apart_here, apart(found.rendering.intensity, plain))
    return f"1e-3, 1 and 2e3 m: {error:.1e} apart", error


CASES = (
    Case(1, "zero quaternion", "no rotation, zero gradient", 1e-5, _zero_quaternion),
    Case(2, "quaternion of any length", "the same image", 1e-5, _long_quaternions),
    Case(3, "log-scales of +-100 and more", "held, zero gradient", 1e-4, _endless_scales),
    Case(4, "needles of 1e2:1 and 1e4:1", "as in float64", 1e-4, _needles),
    Case(5, "far below a pixel", "keeps its energy, but for the cut at 1/255", 0.25, _below_a_pixel),
    Case(6, "over the whole image", "as opaque everywhere", 1e-3, _over_the_image),
    Case(7, "on, before and behind the near plane", "a sharp cut, zero gradient", 1e-4, _near_plane),
    Case(8, "far off the axis", "the Jacobian is held", 1e-4, _off_the_axis),
    Case(9, "opacity logits of +-100", "alpha below its cap, finite gradient", 1e-4, _endless_logits),
    Case(10, "1,000 stacked Gaussians", "no blow-up; what is left where one stops", 2e-4, _stacked),
    Case(11, "2,000 faint layers", "transmittance within bounds", 1e-4, _transmittance),
    Case(12, "nothing to see", "the background, zero gradient", 0.0, _nothing),
    Case(13, "equal depths", "the order given, twice the same", 1e-3, _equal_depths),
    Case(14, "all dead", "nothing seen, zero gradient", 0.0, _all_dead),
    Case(15, "scene scale", "the same image in any unit", 1e-4, _units),
)
