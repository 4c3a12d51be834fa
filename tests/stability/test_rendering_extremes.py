"""The stress catalogue's rendering cases, on both backends: finite, and the same wherever an answer is defined."""

import math

import pytest
import torch

from reconstruction.rendering.render import Rendering, render
from rigs.camera import Camera
from rigs.transform import Transform

CAMERA = Camera("cam11", 40, 28, 60.0, 60.0, 20.0, 14.0, Transform.identity())
BACKENDS = ("native", "reference")


def gaussians_of(n: int = 1, **changes) -> tuple[torch.Tensor, ...]:
    """N equal Gaussians at a pixel's centre, two metres away, 3 px wide; `changes` replace whole tensors."""
    tensors = {
        "means": torch.tensor([[0.5 / 30, 0.5 / 30, 2.0]]).repeat(n, 1),
        "quats_wxyz": torch.tensor([[1.0, 0, 0, 0]]).repeat(n, 1),
        "log_scales": torch.full((n, 3), math.log(0.1)),
        "opacities": torch.full((n,), 0.7),
        "intensities": torch.ones(n, 1),
    }
    return tuple({**tensors, **changes}.values())


def run(gaussians: tuple[torch.Tensor, ...], backend: str, **options) -> tuple[Rendering, list[torch.Tensor]]:
    dtype = torch.float32 if backend == "native" else torch.float64
    leaves = tuple(t.detach().to(dtype).clone().requires_grad_() for t in gaussians)
    rendering = render(leaves, CAMERA, backend=backend, **options)  # type: ignore[arg-type]
    # Not symmetric, or the gradients would cancel.
    weights = 0.2 + torch.rand(28, 40, generator=torch.Generator().manual_seed(3)).to(dtype)
    (weights * (rendering.intensity[..., 0] + 0.1 * rendering.depth + 0.3 * rendering.alpha)).sum().backward()
    rendering = Rendering(*(t.detach() for t in vars(rendering).values()))
    return rendering, [torch.zeros_like(t) if t.grad is None else t.grad for t in leaves]


def checked(
    gaussians: tuple[torch.Tensor, ...], tolerance: float = 1e-4, **options
) -> tuple[Rendering, list[torch.Tensor]]:
    """The native result, after both backends were found finite, bounded and alike."""
    results = [run(gaussians, backend, **options) for backend in BACKENDS]
    for rendering, grads in results:
        for tensor in (rendering.intensity, rendering.depth, rendering.alpha, *grads):
            assert bool(torch.isfinite(tensor).all())
        assert float(rendering.alpha.min()) >= 0
        assert float(rendering.alpha.max()) <= 1
    (native, native_grads), (reference, reference_grads) = results
    for name in ("intensity", "depth", "alpha"):
        got, expected = getattr(native, name).double(), getattr(reference, name)
        torch.testing.assert_close(got, expected, rtol=tolerance, atol=tolerance)
    for got, expected in zip(native_grads, reference_grads, strict=True):
        scale = max(float(expected.abs().max()), 1e-3)
        torch.testing.assert_close(got.double() / scale, expected / scale, rtol=0, atol=10 * tolerance)
    return native, native_grads


def test_01_a_zero_quaternion_is_no_rotation():
    scales = torch.tensor([[-2.0, -3.0, -4.0]])
    zero, grads = checked(gaussians_of(quats_wxyz=torch.zeros(1, 4), log_scales=scales))
    assert (zero.intensity == checked(gaussians_of(log_scales=scales))[0].intensity).all()
    assert (grads[1] == 0).all()


@pytest.mark.parametrize("factor", [1e20, 1e-20, 1e-3])
def test_02_the_length_of_a_quaternion_does_not_matter(factor):
    quats, scales = torch.tensor([[0.8, 0.1, -0.5, 0.3]]), torch.tensor([[-2.0, -3.0, -4.0]])
    unit = render(gaussians_of(quats_wxyz=quats, log_scales=scales), CAMERA)
    gaussians = gaussians_of(quats_wxyz=quats * factor, log_scales=scales)
    for backend in BACKENDS:
        rendering, grads = run(gaussians, backend)
        torch.testing.assert_close(rendering.intensity.float(), unit.intensity, rtol=1e-5, atol=1e-6)
        assert all(bool(torch.isfinite(g).all()) for g in grads)


@pytest.mark.parametrize("log_scale", [100.0, -100.0, 20.0, 3e38, -3e38])
def test_03_endless_scales_are_held(log_scale):
    rendering, grads = checked(gaussians_of(log_scales=torch.full((1, 3), log_scale)))
    assert (grads[2] == 0).all()
    assert float(rendering.alpha.mean()) == pytest.approx(0.7 if log_scale > 0 else 0.0, abs=1e-6)


@pytest.mark.parametrize("degrees", [0.0, 17.0, 45.0, 90.0])
@pytest.mark.parametrize("ratio", [1e2, 1e4])
def test_04_needles_agree_with_float64(degrees, ratio):
    half = math.radians(degrees) / 2
    quats = torch.tensor([[math.cos(half), 0, 0, math.sin(half)]])
    long = math.log(0.3)
    scales = torch.tensor([[long, long - math.log(ratio), long - math.log(ratio)]])
    for backend in BACKENDS:  # 0.7 of a needle this thin is nothing: thousands of it are a line
        assert bool(torch.isfinite(run(gaussians_of(quats_wxyz=quats, log_scales=scales), backend)[0].alpha).all())
    thick = torch.tensor([[long + math.log(ratio) / 2, long - math.log(ratio) / 2, long - math.log(ratio) / 2]])
    checked(gaussians_of(quats_wxyz=quats, log_scales=thick))


def test_05_a_gaussian_below_a_pixel_keeps_its_energy():
    energies = []
    for scale in (0.02, 0.01, 0.005):  # 0.6, 0.3, 0.15 px
        rendering, _ = checked(gaussians_of(log_scales=torch.full((1, 3), math.log(scale))))
        energies.append(float(rendering.alpha.double().sum()) / (2 * math.pi * 0.7 * (60 * scale / 2) ** 2))
    # What is lost lies below the cut at 1/255; without the compensation the last one would be 13 times too bright.
    assert energies == pytest.approx([1, 1, 1], abs=0.25)


def test_06_one_gaussian_over_the_whole_image():
    rendering, _ = checked(gaussians_of(log_scales=torch.full((1, 3), 3.0)))
    assert float(rendering.alpha.min()) == pytest.approx(0.7, abs=1e-3)


@pytest.mark.parametrize("z", [0.0, -0.0, -1.0, 1e-30, -1e-30, -3e38])
def test_07_behind_or_on_the_camera_nothing_is_seen(z):
    rendering, grads = checked(gaussians_of(means=torch.tensor([[0.001, 0.001, z]])))
    assert int(rendering.radii.sum()) == 0
    assert float(rendering.alpha.max()) == 0
    assert all((g == 0).all() for g in grads)


@pytest.mark.parametrize("seen", [True, False])
def test_07_the_near_plane_is_sharp(seen):
    near = 0.25
    z = near if seen else float(torch.nextafter(torch.tensor(near), torch.tensor(0.0)))
    gaussians = gaussians_of(means=torch.tensor([[0.0, 0.0, z]]))
    for backend in BACKENDS:
        rendering, grads = run(gaussians, backend, near_m=near)
        assert bool(rendering.radii.sum() > 0) == seen
        assert any((g != 0).any() for g in grads) == seen
        assert all(bool(torch.isfinite(g).all()) for g in grads)


@pytest.mark.parametrize("x", [0.7, 1.0, 3.0, 100.0, 1e20])
def test_08_far_off_the_axis_the_jacobian_is_held(x):
    checked(gaussians_of(means=torch.tensor([[x, 0.1, 2.0]]), log_scales=torch.full((1, 3), -0.5)))
    checked(gaussians_of(means=torch.tensor([[x, 0.1, 0.02]])))


@pytest.mark.parametrize("logit", [100.0, -100.0, 30.0, -30.0])
def test_09_endless_opacity_logits(logit):
    logits = torch.full((1,), logit, requires_grad=True)
    gaussians = (*gaussians_of()[:3], logits.sigmoid(), torch.ones(1, 1))
    render(gaussians, CAMERA).intensity.sum().backward()
    assert logits.grad is not None
    assert bool(torch.isfinite(logits.grad).all())
    rendering, _ = checked(gaussians)
    assert float(rendering.alpha.max()) <= 0.99 + 1e-6


@pytest.mark.parametrize("opacity", [1.0, 0.999, 0.5])
def test_10_a_thousand_stacked_gaussians(opacity):
    depths = torch.linspace(1.0, 3.0, 1000)
    means = torch.stack([depths * 0.25 / 30, depths * 0.25 / 30, depths], 1)
    stacked = gaussians_of(1000, means=means, opacities=torch.full((1000,), opacity))
    rendering, grads = checked(stacked)
    assert all(float(g.abs().max()) < 1e6 for g in grads)
    assert float(rendering.alpha[14, 20]) >= 1 - 1.1e-4


def test_11_the_transmittance_stays_within_bounds():
    generator = torch.Generator().manual_seed(0)
    faint = gaussians_of(2000, opacities=torch.rand(2000, generator=generator) / 100)
    rendering, _ = checked(faint)
    assert float(rendering.alpha.max()) <= 1


def test_12_no_gaussians_give_the_background():
    for backend in BACKENDS:
        rendering, grads = run(gaussians_of(0), backend, background=0.25)
        assert (rendering.intensity == 0.25).all()
        assert (rendering.alpha == 0).all()
        assert [g.numel() for g in grads] == [0] * 5


def test_12_nothing_visible_gives_the_background_and_no_gradient():
    beside = gaussians_of(3, means=torch.tensor([[50.0, 0, 2], [0, -50, 2], [0, 0, -2]]))
    rendering, grads = checked(beside, background=0.25)
    assert (rendering.intensity == 0.25).all()
    assert all((g == 0).all() for g in grads)


def test_13_equal_depths_keep_the_order_they_were_given_in():
    intensities = torch.tensor([[1.0], [2.0], [3.0]])
    gaussians = gaussians_of(3, intensities=intensities)
    rendering, _ = checked(gaussians)
    keeps = (60 * 0.1 / 2) ** 2 / ((60 * 0.1 / 2) ** 2 + 0.3)
    a = 0.7 * keeps
    expected = a * 1 + (1 - a) * a * 2 + (1 - a) ** 2 * a * 3
    assert float(rendering.intensity[14, 20, 0]) == pytest.approx(expected, rel=1e-3)


def test_14_gaussians_that_are_all_dead_are_not_seen():
    rendering, grads = checked(gaussians_of(5, opacities=torch.zeros(5)))
    assert int(rendering.radii.sum()) == 0
    assert all((g == 0).all() for g in grads)


@pytest.mark.parametrize("size", [1e-3, 1.0, 2e3])
def test_15_the_image_does_not_depend_on_the_unit_of_length(size):
    plain = render(gaussians_of(), CAMERA)
    means, quats, log_scales, opacities, intensities = gaussians_of()
    scaled = (means * size, quats, log_scales + math.log(size), opacities, intensities)
    checked(scaled, near_m=0.01 * size)
    rendering = render(scaled, CAMERA, near_m=0.01 * size)
    torch.testing.assert_close(rendering.intensity, plain.intensity, rtol=1e-5, atol=1e-5)
