import pytest
import torch

from reconstruction.losses.variation import EPS, variation_loss


def test_equal_frames_lose_nothing():
    frames = torch.rand(4, 5, 6, dtype=torch.float64)
    assert variation_loss(frames, frames) == 0


def test_a_constant_signal_has_a_zero_gradient_and_not_nan():
    rendered = torch.full((4, 3, 3), 0.4, dtype=torch.float64, requires_grad=True)
    variation_loss(rendered, torch.full((4, 3, 3), 0.4, dtype=torch.float64)).backward()
    assert rendered.grad is not None
    assert (rendered.grad == 0).all()


def test_it_is_the_mean_and_the_deviation_of_the_differences():
    rendered = torch.tensor([0.0, 1.0, 1.0], dtype=torch.float64)[:, None, None]
    target = torch.tensor([0.0, 0.5, 1.0], dtype=torch.float64)[:, None, None]
    # differences (1, 0) and (0.5, 0.5): equal means, deviations 0.5 and 0
    expected = (0.25 + EPS) ** 0.5 - EPS**0.5
    assert variation_loss(rendered, target).item() == pytest.approx(expected, abs=1e-12)


def test_an_offset_that_stays_is_not_a_variation():
    frames = torch.rand(5, 4, 4, dtype=torch.float64)
    assert variation_loss(frames + 0.3, frames).item() == pytest.approx(0, abs=1e-12)


def test_its_gradient_is_the_numerical_one():
    generator = torch.Generator().manual_seed(0)
    rendered = torch.rand(4, 3, 3, dtype=torch.float64, generator=generator, requires_grad=True)
    target = torch.rand(4, 3, 3, dtype=torch.float64, generator=generator)
    assert torch.autograd.gradcheck(lambda r: variation_loss(r, target), (rendered,))


@pytest.mark.parametrize("scale", [1e-12, 1e12])
def test_tiny_and_huge_light_stay_finite(scale):
    rendered = (torch.rand(3, 4, 4, dtype=torch.float64) * scale).requires_grad_()
    loss = variation_loss(rendered, torch.rand(3, 4, 4, dtype=torch.float64) * scale)
    loss.backward()
    assert torch.isfinite(loss)
    assert rendered.grad is not None
    assert torch.isfinite(rendered.grad).all()
