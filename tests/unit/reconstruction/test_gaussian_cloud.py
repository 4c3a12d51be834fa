"""Stored Gaussians: shapes, construction, selection."""

import pytest
import torch

from reconstruction.errors import ReconstructionError
from reconstruction.gaussians.cloud import GaussianCloud


def cloud_of(n: int, channels: int = 1) -> GaussianCloud:
    generator = torch.Generator().manual_seed(n)
    draw = lambda *shape: torch.randn(*shape, generator=generator)  # noqa: E731
    return GaussianCloud(draw(n, 3), draw(n, 4), draw(n, 3), draw(n), draw(n, channels))


def test_points_become_round_gaussians_of_the_given_size_and_opacity():
    points, scales = torch.randn(5, 3), torch.rand(5) + 0.1
    cloud = GaussianCloud.from_points(points, torch.ones(5, 1), scales.log(), 0.3)
    assert len(cloud) == 5
    torch.testing.assert_close(cloud.means, points)
    torch.testing.assert_close(cloud.log_scales.exp(), scales[:, None].expand(5, 3))
    torch.testing.assert_close(cloud.opacity_logits.sigmoid(), torch.full((5,), 0.3))
    assert (cloud.quats_wxyz == torch.tensor([1.0, 0, 0, 0])).all()


def test_changing_a_cloud_leaves_its_points_alone():
    points = torch.zeros(2, 3)
    GaussianCloud.from_points(points, torch.ones(2, 1), torch.zeros(2), 0.5).means += 1
    assert (points == 0).all()


def test_select_takes_a_mask_or_indices_in_their_order():
    cloud = cloud_of(7)
    for name, tensor in vars(cloud.select(torch.arange(7) >= 3)).items():
        assert (tensor == getattr(cloud, name)[3:]).all()
    for name, tensor in vars(cloud.select(torch.tensor([2, 0]))).items():
        assert (tensor == getattr(cloud, name)[[2, 0]]).all()


def test_an_empty_cloud_is_a_cloud():
    assert len(cloud_of(3).select(torch.zeros(3, dtype=torch.bool))) == 0


@pytest.mark.parametrize("name", ["means", "quats_wxyz", "log_scales", "opacity_logits", "intensities"])
def test_nan_is_refused_by_name(name):
    tensors = vars(cloud_of(3))
    tensors[name] = tensors[name] * torch.nan
    with pytest.raises(ReconstructionError, match=name):
        GaussianCloud(**tensors)


@pytest.mark.parametrize("name", ["quats_wxyz", "log_scales", "opacity_logits", "intensities"])
def test_a_tensor_of_another_length_is_refused_by_name(name):
    tensors = vars(cloud_of(3))
    tensors[name] = tensors[name][:2]
    with pytest.raises(ReconstructionError, match=name):
        GaussianCloud(**tensors)
