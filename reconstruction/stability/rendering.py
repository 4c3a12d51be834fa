"""Defines cases 1 to 15: Gaussians at the limits of every renderer."""

import itertools
import math

import torch

from reconstruction.rendering.result import GUARDS, Instantaneous
from reconstruction.stability.case import Case, Observation
from reconstruction.stability.probe import Apart, against_reference, apart, gaussians_of, probe, renderers, worst


def _worst(cases: list[Instantaneous], renderer: str, **options: float) -> Observation:
    error = worst(against_reference(gaussians, renderer, **options)[1] for gaussians in cases)
    return Observation(f"{len(cases)} renderings, worst {error.images:.1e} from float64", *error)


def _zero_quaternion(renderer: str) -> Observation:
    scales = torch.tensor([[-2.0, -3.0, -4.0]])
    found, error = against_reference(gaussians_of(quats_wxyz=torch.zeros(1, 4), log_scales=scales), renderer)
    identity = probe(gaussians_of(log_scales=scales), renderer)
    turn = float(found.gradients[1].abs().max())
    most = max(error.images, apart(found.rendering.intensity, identity.rendering.intensity), turn)
    return Observation(f"the identity to {most:.1e}, gradient {turn:.0e}", most, error.gradients)


def _long_quaternions(renderer: str) -> Observation:
    quats, scales = torch.tensor([[0.8, 0.1, -0.5, 0.3]]), torch.tensor([[-2.0, -3.0, -4.0]])
    unit = probe(gaussians_of(quats_wxyz=quats, log_scales=scales), renderer)
    error, slope = 0.0, 0.0
    for length in (1e20, 1e-20, 1e-3):
        found = probe(gaussians_of(quats_wxyz=quats * length, log_scales=scales), renderer)
        error = max(error, apart(found.rendering.intensity, unit.rendering.intensity) if found.sound else math.inf)
        slope = max(slope, apart(found.gradients[1] * length, unit.gradients[1]))
    return Observation(f"lengths 1e20, 1e-20, 1e-3: {error:.1e} apart", error, slope)


def _endless_scales(renderer: str) -> Observation:
    clouds = [gaussians_of(log_scales=torch.full((1, 3), s)) for s in (100.0, -100.0, 20.0, 3e38, -3e38)]
    found = [probe(cloud, renderer) for cloud in clouds]
    slope = max(float(p.gradients[2].abs().max()) for p in found)
    covers = zip(found, (0.7, 0, 0.7, 0.7, 0), strict=True)
    cover = max(abs(float(p.rendering.alpha.mean()) - expected) for p, expected in covers)
    said, error, steepest = _worst(clouds, renderer)
    return Observation(f"{said}, gradient {slope:.0e}", max(error, slope, cover), steepest)


def _needles(renderer: str) -> Observation:
    clouds, thin = [], []
    for degrees, ratio in itertools.product((0.0, 17.0, 45.0, 90.0), (1e2, 1e4)):
        half = math.radians(degrees) / 2
        quats = torch.tensor([[math.cos(half), 0, 0, math.sin(half)]])
        for needles, length in ((clouds, 0.3 * math.sqrt(ratio)), (thin, 0.3)):
            scales = torch.tensor([[length, *[length / ratio] * 2]]).log()
            needles.append(gaussians_of(quats_wxyz=quats, log_scales=scales))
    found = _worst(clouds, renderer)
    return found if all(probe(cloud, renderer).sound for cloud in thin) else found._replace(error=math.inf)


def _below_a_pixel(renderer: str) -> Observation:
    energies, slope = [], 0.0
    for scale in (0.02, 0.01, 0.005):  # 0.6, 0.3, 0.15 px
        found, error = against_reference(gaussians_of(log_scales=torch.full((1, 3), math.log(scale))), renderer)
        whole = 2 * math.pi * 0.7 * (60 * scale / 2) ** 2
        energies.append(float(found.rendering.alpha.sum()) / whole if max(error) < 1e-3 else math.inf)
        slope = max(slope, error.gradients)
    said = ", ".join(f"{e:.2f}" for e in energies)
    return Observation(f"{said} of the energy at 0.6, 0.3, 0.15 px", max(abs(e - 1) for e in energies), slope)


def _over_the_image(renderer: str) -> Observation:
    found, error = against_reference(gaussians_of(log_scales=torch.full((1, 3), 3.0)), renderer)
    least = float(found.rendering.alpha.min())
    said = f"alpha {least:.4f} at least, radius {int(found.rendering.radii[0])} px"
    return Observation(said, max(error.images, abs(least - 0.7)), error.gradients)


def _near_plane(renderer: str) -> Observation:
    near = torch.tensor(0.25)
    before = torch.nextafter(near, torch.tensor(0.0))
    seen, (error, slope) = against_reference(gaussians_of(means=torch.tensor([[0.0, 0.0, 0.25]])), renderer, 0.25)
    for z in (float(before), 0.0, -0.0, -1.0, 1e-30, -3e38):
        hidden = probe(gaussians_of(means=torch.tensor([[0.001, 0.001, z]])), renderer, near_m=0.25)
        light = float(hidden.rendering.alpha.max()) + sum(float(g.abs().max()) for g in hidden.gradients)
        error = max(error, light if hidden.sound else math.inf)
    error = error if int(seen.rendering.radii[0]) > 0 else math.inf
    return Observation(f"seen at the plane, dark before and behind it, to {error:.1e}", error, slope)


def _off_the_axis(renderer: str) -> Observation:
    places = (0.7, 1.0, 3.0, 100.0, 1e20)
    far = [gaussians_of(means=torch.tensor([[x, 0.1, 2.0]]), log_scales=torch.full((1, 3), -0.5)) for x in places]
    near = [gaussians_of(means=torch.tensor([[x, 0.1, 0.02]])) for x in places]
    return _worst([*far, *near], renderer)


def _endless_logits(renderer: str) -> Observation:
    logits = torch.tensor([100.0, -100.0, 30.0, -30.0], requires_grad=True)
    opacities = logits.sigmoid()
    (slopes,) = torch.autograd.grad(opacities.sum(), logits)
    found = [against_reference(gaussians_of(opacities=opacity), renderer) for opacity in opacities.split(1)]
    error, most = worst(errors for _, errors in found), max(float(p.rendering.alpha.max()) for p, _ in found)
    held = most <= (0.999 if renderer == "gsplat" else 0.99) + 1e-6 and bool(slopes.isfinite().all())
    return Observation(f"alpha at most {most:.4f}", error.images if held else math.inf, error.gradients)


def _stacked(renderer: str) -> Observation:
    depths = torch.linspace(1.0, 3.0, 1000)
    means = torch.stack([depths * 0.25 / 30, depths * 0.25 / 30, depths], 1)
    error, slope, steepest = 0.0, 0.0, 0.0
    for opacity in (0.999, 0.5):
        cloud = gaussians_of(1000, means=means, opacities=torch.full((1000,), opacity))
        found, here = against_reference(cloud, renderer)
        error = max(error, here.images, 1 - float(found.rendering.alpha[14, 20]))
        slope = max(slope, here.gradients)
        steepest = max(steepest, *(float(g.abs().max()) for g in found.gradients))
    said = f"{error:.1e} from float64, gradients below {steepest:.1e}"
    return Observation(said, error if steepest < 1e6 else math.inf, slope)


def _transmittance(renderer: str) -> Observation:
    faint = torch.rand(2000, generator=torch.Generator().manual_seed(0)) / 100
    return _worst([gaussians_of(2000, opacities=faint)], renderer)


def _nothing(renderer: str) -> Observation:
    beside = gaussians_of(3, means=torch.tensor([[50.0, 0, 2], [0, -50, 2], [0, 0, -2]]))
    found = [probe(cloud, renderer, background=0.25) for cloud in (gaussians_of(0), beside)]
    light = max(apart(f.rendering.intensity, torch.tensor(0.25)) for f in found)
    slope = max(float(g.abs().max()) for g in found[1].gradients)
    return Observation(f"the background to {light:.0e}, gradient {slope:.0e}", light, slope)


def _equal_depths(renderer: str) -> Observation:
    cloud = gaussians_of(3, intensities=torch.tensor([[1.0], [2.0], [3.0]]))
    found, again = (probe(cloud, renderer).rendering.intensity for _ in range(2))
    _, (_, slope) = against_reference(cloud, renderer)
    a = 0.7 * 9 / (9 + GUARDS.dilation_px2)  # opacity after a dilation of 9 px^2
    expected = a * 1 + (1 - a) * a * 2 + (1 - a) ** 2 * a * 3
    error = max(abs(float(found[14, 20, 0]) - expected), apart(found, again))
    return Observation(f"in the order given, twice the same, to {error:.1e}", error, slope)


def _all_dead(renderer: str) -> Observation:
    found = probe(gaussians_of(5, opacities=torch.zeros(5)), renderer)
    light, slope = float(found.rendering.alpha.max()), max(float(g.abs().max()) for g in found.gradients)
    said = f"{int((found.rendering.radii > 0).sum())} seen, light {light:.0e}, gradient {slope:.0e}"
    return Observation(said, light, slope)


def _units(renderer: str) -> Observation:
    one = gaussians_of()
    plain = probe(one, renderer).rendering.intensity
    errors = []
    for size in (1e-3, 1.0, 2e3):
        scaled = one._replace(means=one.means * size, log_scales=one.log_scales + math.log(size))
        found, here = against_reference(scaled, renderer, near_m=0.01 * size)
        errors += [here, Apart(apart(found.rendering.intensity, plain), 0.0)]
    error = worst(errors)
    return Observation(f"1e-3, 1 and 2e3 m: {error.images:.1e} apart", *error)


CASES = (
    Case(1, "zero quaternion", "no rotation, zero gradient", 1e-5, _zero_quaternion, renderers),
    Case(2, "quaternion of any length", "the same image", 1e-5, _long_quaternions, renderers),
    Case(3, "log-scales of +-100 and more", "held, zero gradient", 1e-4, _endless_scales, renderers),
    Case(4, "needles of 1e2:1 and 1e4:1", "as in float64", 1e-4, _needles, renderers),
    Case(5, "far below a pixel", "keeps its energy, but for the cut at 1/255", 0.25, _below_a_pixel, renderers),
    Case(6, "over the whole image", "as opaque everywhere", 1e-3, _over_the_image, renderers),
    Case(7, "on, before and behind the near plane", "a sharp cut, zero gradient", 1e-4, _near_plane, renderers),
    Case(8, "far off the axis", "the Jacobian is held", 1e-4, _off_the_axis, renderers),
    Case(9, "opacity logits of +-100", "alpha below its cap, finite gradient", 1e-4, _endless_logits, renderers),
    Case(10, "1,000 stacked Gaussians", "no blow-up; what is left where one stops", 2e-4, _stacked, renderers),
    Case(11, "2,000 faint layers", "transmittance within bounds", 1e-4, _transmittance, renderers),
    Case(12, "nothing to see", "the background, zero gradient", 0.0, _nothing, renderers),
    Case(13, "equal depths", "the order given, twice the same", 1e-3, _equal_depths, renderers),
    Case(14, "all dead", "nothing seen, zero gradient", 0.0, _all_dead, renderers),
    Case(15, "scene scale", "the same image in any unit", 1e-4, _units, renderers),
)
