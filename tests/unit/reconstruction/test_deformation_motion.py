"""The deformation network against a plain one, its gradients, and how it starts."""

import math

import pytest
import torch

from reconstruction.gaussians import deformation
from reconstruction.gaussians.cloud import GaussianCloud
from reconstruction.gaussians.deformation import DeformationMotion, encoded
from reconstruction.gaussians.hexplane import HexPlaneMotion


@pytest.fixture(autouse=True)
def _small(monkeypatch):
    monkeypatch.setattr(deformation, "WIDTH", 6)


@pytest.mark.parametrize("model", [DeformationMotion, HexPlaneMotion])
def test_it_starts_as_no_deformation(model, cloud_of, field_of):
    cloud = cloud_of(9)
    motion = field_of(model, cloud, trained=False)
    for u in (0.0, 0.4, 1.0):
        now = motion.at(cloud, u)
        assert torch.equal(now.means, cloud.means)
        assert torch.equal(now.quats_wxyz, cloud.quats_wxyz)
        assert torch.equal(now.log_scales, cloud.log_scales)


def test_the_encoding_is_the_value_and_its_waves():
    row = encoded(torch.tensor([[0.3]]), 3)[0]
    waves = [f(math.pi * 0.3 * 2**k) for f in (math.sin, math.cos) for k in range(3)]
    torch.testing.assert_close(row, torch.tensor([0.3, *waves]))


def test_it_is_a_network_with_the_input_given_again_half_way(cloud_of, field_of):
    """In plain loops over points and layers, in float64."""
    cloud = cloud_of(4)
    motion = DeformationMotion(**{name: t.double() for name, t in field_of(DeformationMotion, cloud).tensors()})
    places, u = torch.rand(4, 3, dtype=torch.float64) * 2 - 1, 0.37
    offsets = torch.cat(motion.offsets(places, u), dim=1)
    for point in range(4):
        time = encoded(torch.tensor([[2 * u - 1]], dtype=torch.float64), deformation.TIME_OCTAVES)
        x = torch.cat([encoded(places[point : point + 1], deformation.PLACE_OCTAVES), time], dim=1)[0]
        one = torch.cat([x, x.new_ones(1)])
        values = (motion.entry @ one).relu()
        for i in range(deformation.INNER):
            values = motion.inner[i] @ torch.cat([values, x.new_ones(1)])
            if i == deformation.INNER // 2:
                values = values + motion.again @ one
            values = values.relu()
        torch.testing.assert_close(offsets[point], motion.exit @ torch.cat([values, x.new_ones(1)]))


def test_gradients_agree_with_numerical_ones(cloud_of, field_of):
    cloud = GaussianCloud(*(tensor.double() for tensor in vars(cloud_of(3)).values()))
    motion = DeformationMotion(**{name: t.double() for name, t in field_of(DeformationMotion, cloud_of(3)).tensors()})
    leaves = [t.requires_grad_() for name, t in (*list(vars(cloud).items())[1:], *motion.tensors()) if name != "box"]

    def outputs(*tensors):
        moving = GaussianCloud(cloud.means, *tensors[:4])
        return tuple(DeformationMotion(motion.box, *tensors[4:]).at(moving, 0.37))

    assert torch.autograd.gradcheck(outputs, leaves, fast_mode=True)


def test_means_are_moved_but_not_taught_through_the_encoding(cloud_of, field_of):
    cloud = cloud_of(5)
    motion = field_of(DeformationMotion, cloud)
    cloud.means.requires_grad_()
    motion.at(cloud, 0.4).means.sum().backward()
    assert torch.equal(cloud.means.grad, torch.ones(5, 3))
