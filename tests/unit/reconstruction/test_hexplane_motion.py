"""The field of 4dgs: starts as none, gradients, an independent sampler, and points or instants it does not cover."""

import pytest
import torch

from reconstruction.gaussians import hexplane
from reconstruction.gaussians.cloud import GaussianCloud
from reconstruction.gaussians.hexplane import HexPlaneMotion


@pytest.fixture(autouse=True)
def _small(monkeypatch):
    monkeypatch.setattr(hexplane, "SPACE_CELLS", (4, 6))
    monkeypatch.setattr(hexplane, "TIME_CELLS", 5)
    monkeypatch.setattr(hexplane, "FEATURES", 2)
    monkeypatch.setattr(hexplane, "WIDTH", 6)


def test_a_trained_one_deforms_with_time_and_leaves_opacity_and_light(cloud_of, field_of):
    cloud = cloud_of(9)
    motion = field_of(HexPlaneMotion, cloud)
    first, last = motion.at(cloud, 0.1), motion.at(cloud, 0.9)
    assert float((first.means - last.means).abs().amin()) > 1e-4
    assert torch.equal(first.opacities, cloud.opacity_logits.sigmoid())
    assert torch.equal(last.intensities, cloud.intensities)


def test_samples_are_the_product_of_six_bilinear_ones(cloud_of, field_of):
    """Against a loop that follows equation 5 of the paper: f = product over planes of interp(R_ij)."""
    cloud = cloud_of(5)
    motion = field_of(HexPlaneMotion, cloud)
    places, u = torch.rand(5, 3) * 2 - 1, 0.37

    def interp(plane, column, row):  # [F, rows, columns], both in -1 to 1
        c, r = ((x + 1) / 2 * (n - 1) for x, n in ((column, plane.shape[2]), (row, plane.shape[1])))
        i, j = min(int(r), plane.shape[1] - 2), min(int(c), plane.shape[2] - 2)
        a, b = r - i, c - j
        low = (1 - b) * plane[:, i, j] + b * plane[:, i, j + 1]
        return (1 - a) * low + a * ((1 - b) * plane[:, i + 1, j] + b * plane[:, i + 1, j + 1])

    for point in range(5):
        x = [float(v) for v in places[point]]
        features = []
        for space, time in ((motion.coarse_space, motion.coarse_time), (motion.fine_space, motion.fine_time)):
            fused = torch.ones(2)
            for k, (first, second) in enumerate(((0, 1), (0, 2), (1, 2))):
                fused = fused * interp(space[k], x[first], x[second]) * interp(time[k], x[k], 2 * u - 1)
            features.append(fused)
        trunk = (motion.trunk[:, :-1] @ torch.cat(features) + motion.trunk[:, -1]).relu()
        hidden = (motion.hidden[0, :, :-1] @ trunk + motion.hidden[0, :, -1]).relu()
        shift = motion.heads[:3, :-1] @ hidden + motion.heads[:3, -1]
        torch.testing.assert_close(motion.offsets(places, u)[0][point], shift, atol=1e-5, rtol=1e-5)


def test_gradients_agree_with_numerical_ones(cloud_of, field_of):
    cloud = GaussianCloud(*(tensor.double() for tensor in vars(cloud_of(3)).values()))
    motion = HexPlaneMotion(**{name: t.double() for name, t in field_of(HexPlaneMotion, cloud_of(3)).tensors()})
    learnt = [t.requires_grad_() for name, t in (*vars(cloud).items(), *motion.tensors()) if name != "box"]

    def outputs(*tensors):
        model = HexPlaneMotion(motion.box, *tensors[5:])
        return (*model.at(GaussianCloud(*tensors[:5]), 0.37), model.penalty(cloud))

    assert torch.autograd.gradcheck(outputs, learnt, fast_mode=True)


def test_the_penalty_is_that_of_steps_between_cells_and_nought_for_even_planes(cloud_of, field_of):
    motion = field_of(HexPlaneMotion, cloud_of(4), trained=False)
    motion.coarse_space.fill_(0.3)
    motion.fine_space.fill_(0.2)
    assert float(motion.penalty(cloud_of(4))) == 0
    motion.coarse_time[0, 0, 2, :] = 1.5  # second differences of .5, -1, .5 over three rows of 3 x 2 x 3 x 4
    rough = hexplane.SMOOTH_TIME * (0.25 + 1.0 + 0.25) * 4 / (3 * 2 * 3 * 4)
    away = hexplane.TIME_ONE * 0.5 * 4 / (3 * 2 * 5 * 4)
    assert float(motion.penalty(cloud_of(4))) == pytest.approx(rough + away, rel=1e-5)


@pytest.mark.parametrize("n", [1, 2])
def test_one_point_or_two_in_one_place_have_a_field(n, cloud_of, field_of):
    cloud = cloud_of(1)
    cloud = GaussianCloud(*(t.repeat(n, *[1] * (t.ndim - 1)) for t in vars(cloud).values()))
    motion = field_of(HexPlaneMotion, cloud)
    low, high = motion.box
    assert float((high - low).amin()) >= 0.2
    assert all(torch.isfinite(t).all() for t in motion.at(cloud, 0.5))
