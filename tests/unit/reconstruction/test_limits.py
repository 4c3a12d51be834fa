"""Limits that training keeps: light that a pixel can fire, and sizes that a view can show."""

import math

import pytest
import torch
from torch import Tensor

from reconstruction.training.limits import WIDEST, keep_light, keep_sizes

FAR_M = 3.0


def optimizer(values: tuple[float, ...], *, light: bool = False) -> torch.optim.Optimizer:
    leaf = torch.tensor(values, requires_grad=True)
    return torch.optim.Adam([{"params": [leaf], "light": light}])


def sized(means: list[list[float]], sizes_m: list[float]) -> tuple[list[tuple[str, Tensor]], Tensor]:
    """Return the tensors of Gaussians that stand still and of as many that move, and the sizes of the first."""
    sizes = torch.tensor(sizes_m)[:, None].expand(-1, 3).log().contiguous().requires_grad_(True)
    moving = sizes.detach().clone().requires_grad_(True)
    where = torch.tensor(means)
    pairs = [("still.means", where), ("still.log_scales", sizes), ("moving.means", 0 * where)]
    return [*pairs, ("moving.log_scales", moving)], sizes


def test_light_is_kept_where_a_pixel_can_fire():
    values = (-2.5, -1e-9, 0.0, 0.3, 1.0, 4.0, math.inf, -math.inf)
    light, other = optimizer(values, light=True), optimizer(values)
    keep_light(light)
    keep_light(other)
    kept = torch.tensor((0, 0, 0, 0.3, 1, 1, 1, 0))
    assert torch.equal(light.param_groups[0]["params"][0], kept)
    assert torch.equal(other.param_groups[0]["params"][0], torch.tensor(values))


def test_light_that_is_no_number_stays_one_to_be_found():
    light = optimizer((math.nan,), light=True)
    keep_light(light)
    assert light.param_groups[0]["params"][0].isnan().all()


def test_a_needle_is_cut_by_its_distance_and_the_rest_stays():
    tensors, sizes = sized([[0.0, 0, 3], [1.0, 0, 5], [0.0, 0, 21]], [300.0, 0.02, 1.9])
    keep_sizes(tensors, torch.tensor([0.0, 0, 1]), FAR_M)
    assert sizes.exp()[:, 0].tolist() == pytest.approx([2 * WIDEST, 0.02, 1.9])
    assert sizes.requires_grad
    assert dict(tensors)["moving.log_scales"].exp()[:, 0].tolist() == pytest.approx(
        [FAR_M * WIDEST, 0.02, FAR_M * WIDEST]
    )


def test_sizes_without_bound_or_at_a_camera_stay_finite():
    tensors, sizes = sized([[0.0, 0, 0], [0.0, 0, 2], [1e30, 0, 0]], [1.0, math.inf, 1e-30])
    keep_sizes(tensors, torch.zeros(3), FAR_M)
    assert sizes.isfinite().all()


def test_a_size_that_is_no_number_stays_one_to_be_found():
    tensors, sizes = sized([[0.0, 0, 2]], [math.nan])
    keep_sizes(tensors, torch.zeros(3), FAR_M)
    assert sizes.isnan().all()


def test_a_model_without_still_or_moving_gaussians_has_nothing_to_keep():
    tensors, _ = sized([], [])
    keep_sizes([(name, tensor.reshape(0, 3)) for name, tensor in tensors], torch.zeros(3), FAR_M)
    keep_sizes([("field.grid", torch.ones(4))], torch.zeros(3), FAR_M)
