"""Structural similarity in torch: against the formula, single precision against double, at its limits."""

import pytest
import torch

from reconstruction.losses.ssim import ssim_map

SIZES = [(1, 1), (1, 40), (7, 3), (11, 11), (29, 37), (48, 64)]


def images(height: int, width: int, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(seed)
    draw = lambda: torch.rand(height, width, generator=generator)  # noqa: E731
    image = draw()
    return image, (image + 0.3 * (draw() - 0.5)).clamp_min(0), draw() - 0.5


def value_and_gradient(function, image, target, weights, data_range):
    leaf = image.clone().requires_grad_()
    value = function(leaf, target, data_range)
    (value * weights).sum().backward()
    assert leaf.grad is not None
    return value.detach().double(), leaf.grad.double()


@pytest.mark.parametrize("data_range", [0.2, 1.0])
@pytest.mark.parametrize(("height", "width"), SIZES[1:])  # a single pixel's variances are rounding
def test_single_precision_is_enough(height, width, data_range):
    image, target, weights = images(height, width)
    single = value_and_gradient(ssim_map, image, target, weights, data_range)
    double = value_and_gradient(ssim_map, image.double(), target.double(), weights.double(), data_range)
    # Worst measured: 1e-6; for a single pixel, whose variances are rounding beside a C2 of 4e-5, 3e-4 and 1.4e-3.
    torch.testing.assert_close(single[0], double[0], rtol=0, atol=5e-6 if height * width > 1 else 1e-3)
    scale = max(1.0, float(double[1].abs().max()))
    torch.testing.assert_close(single[1] / scale, double[1] / scale, rtol=0, atol=5e-6 if height * width > 1 else 5e-3)


def test_the_gradient_of_the_reference_is_that_of_its_values():
    image, target, _ = images(3, 4)
    assert torch.autograd.gradcheck(lambda x: ssim_map(x, target.double(), 1.0), image.double().requires_grad_())


def test_one_pixel_is_the_formula_without_windows():
    image, target, _ = images(1, 1)
    c1 = 0.01**2
    expected = (2 * image * target + c1) / (image**2 + target**2 + c1)
    torch.testing.assert_close(ssim_map(image, target, 1.0), expected, rtol=1e-3, atol=0)


def test_inside_the_border_a_window_is_the_textbook_sum():
    image, target, _ = images(23, 19)
    x, y = image.double()[4:15, 3:14], target.double()[4:15, 3:14]
    offsets = torch.arange(-5, 6, dtype=torch.float64)
    weights = torch.exp(-(offsets[:, None] ** 2 + offsets**2) / (2 * 1.5**2))
    weights /= weights.sum()
    mx, my = (weights * x).sum(), (weights * y).sum()
    vx, vy, cov = (
        (weights * (x - mx) ** 2).sum(),
        (weights * (y - my) ** 2).sum(),
        (weights * (x - mx) * (y - my)).sum(),
    )
    c1, c2 = 0.01**2, 0.03**2
    expected = (2 * mx * my + c1) * (2 * cov + c2) / ((mx**2 + my**2 + c1) * (vx + vy + c2))
    assert float(ssim_map(image, target, 1.0)[9, 8]) == pytest.approx(float(expected), abs=1e-5)


@pytest.mark.parametrize("make", [torch.zeros, torch.ones, torch.rand])
def test_identical_images_give_one_and_almost_no_gradient(make):
    image = make(30, 41).requires_grad_()
    similarity = ssim_map(image, image.detach().clone(), 1.0)
    similarity.sum().backward()
    assert float((similarity.detach() - 1).abs().max()) < 1e-6
    assert image.grad is not None
    assert float(image.grad.abs().max()) < 1e-2  # a difference of 1e-2 would already give 1


@pytest.mark.parametrize("level", [0.0, 1e-6, 0.5, 30.0])
def test_flat_images_of_different_levels_keep_a_finite_gradient(level):
    image = torch.full((16, 20), level).requires_grad_()
    similarity = ssim_map(image, torch.full((16, 20), 0.25), 1.0)
    similarity.mean().backward()
    assert image.grad is not None
    assert bool(torch.isfinite(similarity).all())
    assert bool(torch.isfinite(image.grad).all())


def test_images_that_do_not_share_memory_order_are_read_as_they_are():
    image, target, _ = images(20, 31)
    torch.testing.assert_close(
        ssim_map(image.T, target.T, 1.0), ssim_map(image.T.contiguous(), target.T.contiguous(), 1.0)
    )
