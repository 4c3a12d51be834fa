"""The loss of a picture: the native kernel against the reference in float64, its formula, and at its limits."""

import math

import pytest
import torch

from reconstruction.errors import ReconstructionError
from reconstruction.losses.picture import (
    PictureLoss,
    Target,
    inverse_depth,
    picture_loss,
    picture_loss_reference,
)
from reconstruction.native import kernels_alone

SIZES = [(1, 1), (1, 40), (7, 3), (32, 32), (33, 31), (37, 70), (64, 96)]
LOSS = PictureLoss(0.6, hold=0.1)


def seen_and_target(height, width, seed=0, dtype=torch.float32):
    """Render, depth and alpha; and a target of which some pixels are empty and some depths are known."""
    generator = torch.Generator().manual_seed(seed)
    draw = lambda: torch.rand(height, width, generator=generator)  # noqa: E731
    light, alpha = draw(), draw()
    depth = 3 * draw()
    off = 0.02 + 0.06 * (draw() > 0.7)  # some beyond the reach of the hold
    known = torch.where(draw() > 0.4, alpha / depth.clamp_min(0.1) * (1 + off), 0.0)
    target = Target(*((light + 0.2 * (draw() - 0.5)).clamp_min(0), (draw() > 0.8).float(), known), shared=1.3)
    given = [t.to(dtype) for t in (target.picture, target.empty, target.inverse_depth) if t is not None]
    return tuple(t.to(dtype) for t in (light, depth, alpha)), Target(*given, shared=1.3)


def outcome(function, seen, target, loss=LOSS):
    """The loss, its three gradients, and the mean squared error."""
    leaves = tuple(image.clone().requires_grad_() for image in seen)
    value, square = function(leaves, target, loss)
    (1.7 * value).backward()
    return [value.detach(), *(leaf.grad for leaf in leaves), torch.tensor(square)]


@pytest.mark.parametrize(("height", "width"), SIZES)
def test_native_agrees_with_the_float64_reference(height, width):
    single = outcome(picture_loss, *seen_and_target(height, width))
    double = outcome(picture_loss_reference, *seen_and_target(height, width, dtype=torch.float64))
    bound = 1e-6 if height * width > 1 else 5e-4  # a single pixel's variances are rounding beside C2
    for one, other in zip(single, double, strict=True):
        scale = max(float(other.abs().max()), 1e-3)
        torch.testing.assert_close(one.double(), other.double(), rtol=0, atol=bound * scale)


@pytest.mark.parametrize(("height", "width"), SIZES)
def test_torch_in_float32_agrees_with_the_kernel(height, width):
    """The twin that a GPU takes, on the CPU; the worst so far was 6e-7 of the largest value."""
    found, expected = (outcome(f, *seen_and_target(height, width)) for f in (picture_loss_reference, picture_loss))
    bound = 1e-5 if height * width > 1 else 5e-3  # a single pixel's variances are rounding beside C2: 2e-3 so far
    for one, other in zip(found, expected, strict=True):
        torch.testing.assert_close(one, other, rtol=0, atol=bound * max(float(other.abs().max()), 1e-3))


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="torch sees no CUDA device")
@pytest.mark.parametrize(("height", "width"), SIZES)
def test_a_gpu_agrees_with_the_kernel(height, width):
    seen, target = seen_and_target(height, width)
    known = (t.cuda() for t in (target.picture, target.empty, target.inverse_depth) if t is not None)
    found = outcome(picture_loss, tuple(t.cuda() for t in seen), Target(*known, shared=target.shared))
    bound = 1e-5 if height * width > 1 else 5e-3
    for one, other in zip(found, outcome(picture_loss, seen, target), strict=True):
        torch.testing.assert_close(one.cpu(), other, rtol=0, atol=bound * max(float(other.abs().max()), 1e-3))


def test_the_gradient_of_the_reference_is_that_of_its_values():
    seen, target = seen_and_target(5, 6, dtype=torch.float64)
    leaves = [image.clone().requires_grad_() for image in seen]
    assert torch.autograd.gradcheck(lambda *s: picture_loss_reference(s, target, LOSS)[0], leaves)


def test_the_hold_is_its_formula():
    alpha = torch.full((4, 6), 0.8)
    depth, known = torch.full((4, 6), 1.62), torch.full((4, 6), 2.0)
    known[0], known[1] = math.nan, 0.5  # not known, and farther off than the hold reaches
    seen = torch.zeros(4, 6), depth, alpha
    target = Target(torch.zeros(4, 6), inverse_depth=inverse_depth(known.numpy()))
    _, _, by_depth, by_alpha, *_ = outcome(picture_loss, seen, target, loss=PictureLoss(1.0, solid=0.0, hold=0.2))
    value, _ = picture_loss(seen, target, PictureLoss(1.0, solid=0.0, hold=0.2))
    assert float(value) == pytest.approx(0.2 * (0.01 * 12 + 0.05 * 6) / 24, rel=1e-4)
    assert by_depth[:2].abs().max() == 0
    torch.testing.assert_close(by_depth[2:], torch.full((2, 6), 1.7 * 0.2 * 0.5 / 24))
    torch.testing.assert_close(by_alpha[2:], torch.full((2, 6), -1.7 * 0.2 / 24))


@pytest.mark.parametrize("value", [math.nan, math.inf, 0.0, -1.0])
def test_what_is_no_depth_is_not_known(value):
    assert not inverse_depth(torch.full((3, 4), value).numpy()).any()


@pytest.mark.parametrize("make", [torch.zeros, torch.ones, torch.rand])
def test_equal_pictures_have_no_loss_and_almost_no_gradient(make):
    light, full = make(30, 41), torch.ones(30, 41)
    found = outcome(picture_loss, (light, full, full), Target(light.clone()))
    assert abs(float(found[0])) < 1e-6
    assert float(found[1].abs().max()) * 30 * 41 < 1e-2  # a difference of 1e-2 would already give 1


@pytest.mark.parametrize("level", [0.0, 1e-30, 1e-6, 0.5, 30.0, 1e8])
def test_flat_pictures_keep_finite_gradients(level):
    seen = torch.full((16, 20), level), torch.full((16, 20), level), torch.full((16, 20), 0.5)
    target = Target(torch.full((16, 20), 0.25), inverse_depth=torch.full((16, 20), 1e30))
    for image in outcome(picture_loss, seen, target):
        assert image.isfinite().all()


def test_nan_in_a_render_shows_in_the_loss():
    (light, depth, alpha), target = seen_and_target(40, 40)
    light[3, 4] = math.nan
    assert picture_loss((light, depth, alpha), target, LOSS)[0].isnan()


def test_the_result_does_not_depend_on_threads():
    seen, target = seen_and_target(70, 90)
    before, results = torch.get_num_threads(), []
    try:
        for threads in (1, 2, 3):
            torch.set_num_threads(threads)
            with kernels_alone():
                assert torch.get_num_threads() == 1
                results.append(outcome(picture_loss, seen, target))
            assert torch.get_num_threads() == threads
    finally:
        torch.set_num_threads(before)
    for other in results[1:]:
        assert all(torch.equal(one, two) for one, two in zip(results[0], other, strict=True))


def test_bad_input_is_refused():
    seen, target = seen_and_target(8, 9)
    with pytest.raises(ReconstructionError, match="shapes"):
        picture_loss(seen, Target(torch.zeros(9, 8)), LOSS)
    with pytest.raises(ReconstructionError, match="data range"):
        picture_loss(seen, target, PictureLoss(0.0))
