"""Motion to one instant: native against torch in float64, values and gradients, to the extremes."""

import math

import pytest
import torch

from reconstruction.gaussians.course import Course, evaluated, evaluated_reference


def tensors_of(count: int, order: int, seed: int = 0) -> list[torch.Tensor]:
    generator = torch.Generator().manual_seed(seed)
    draw = lambda *shape: torch.randn(*shape, generator=generator)  # noqa: E731
    tensors = [draw(count, 3), 3 * draw(count), draw(count).sigmoid(), -2 + draw(count)]
    return [*tensors, *(draw(count, 3) for _ in range(order))]


def outcome(function, tensors, instant, dtype):
    leaves = [t.detach().to(dtype).requires_grad_() for t in tensors]
    means, opacities = function(Course(*leaves[:4], tuple(leaves[4:])), instant)
    generator = torch.Generator().manual_seed(9)
    weights = [torch.randn(t.shape, generator=generator).to(dtype) for t in (means, opacities)]
    ((weights[0] * means).sum() + (weights[1] * opacities).sum()).backward()
    grads = [torch.zeros_like(t) if t.grad is None else t.grad for t in leaves]
    return [t.detach().double() for t in (means, opacities, *grads)]


def assert_alike(tensors, instant):
    found = outcome(evaluated, tensors, instant, torch.float32)
    expected = outcome(evaluated_reference, tensors, instant, torch.float64)
    for f, e in zip(found, expected, strict=True):
        assert bool(f.isfinite().all())
        scale = max(1.0, float(e.abs().max())) if e.numel() else 1.0
        torch.testing.assert_close(f / scale, e / scale, rtol=0, atol=1e-6)  # worst measured 2e-7


@pytest.mark.parametrize("order", [0, 1, 2, 3])
@pytest.mark.parametrize("count", [0, 1, 5, 33, 131])
def test_values_and_gradients_agree(order, count):
    assert_alike(tensors_of(count, order), 0.37)


@pytest.mark.parametrize("instant", [-1e6, -1.0, 0.0, 2.0, 1e6])
def test_far_from_the_clip_they_agree(instant):
    assert_alike(tensors_of(20, 1), instant)


@pytest.mark.parametrize("log_duration", [-1e30, math.log(1e-3), 0.0, 1e30])
def test_durations_are_held(log_duration):
    tensors = tensors_of(9, 2)
    tensors[3][:] = log_duration
    assert_alike(tensors, 0.6)


@pytest.mark.parametrize("logit", [-1e30, -100.0, 100.0, 1e30])
def test_endless_logits_agree(logit):
    tensors = tensors_of(6, 1)
    tensors[1][:] = logit
    assert_alike(tensors, 0.5)


def test_the_gradient_of_the_reference_is_that_of_its_values():
    leaves = [t.double().requires_grad_() for t in tensors_of(3, 3)]
    check = lambda *t: evaluated_reference(Course(*t[:4], t[4:]), 0.4)  # noqa: E731
    assert torch.autograd.gradcheck(check, leaves)


def test_the_same_bits_for_any_number_of_threads():
    tensors, before = tensors_of(777, 3), torch.get_num_threads()
    try:
        runs = []
        for threads in (1, 2, 3):
            torch.set_num_threads(threads)
            runs.append(outcome(evaluated, tensors, 0.2, torch.float32))
    finally:
        torch.set_num_threads(before)
    for run in runs[1:]:
        assert all((a == b).all() for a, b in zip(run, runs[0], strict=True))


def test_higher_orders_go_to_the_reference():
    tensors = tensors_of(3, 5)
    found = outcome(evaluated, tensors, 0.3, torch.float32)
    expected = outcome(evaluated_reference, tensors, 0.3, torch.float64)
    for f, e in zip(found, expected, strict=True):
        torch.testing.assert_close(f, e, rtol=1e-5, atol=1e-5)
