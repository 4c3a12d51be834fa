"""The field of 4dgs: starts as none, gradients, an independent sampler, and points or instants it does not cover."""

import pytest
import torch

from reconstruction.gaussians import hexplane
from reconstruction.gaussians.cloud import GaussianCloud
from reconstruction.gaussians.dynamic import DynamicCloud
from reconstruction.gaussians.hexplane import HexPlaneMotion, SmallHexPlaneMotion
from reconstruction.scene_model import TimeSpan

MODELS = (HexPlaneMotion, SmallHexPlaneMotion)


@pytest.fixture(autouse=True)
def _small(small_fields):
    pass


@pytest.mark.parametrize("model", MODELS)
def test_it_starts_as_no_deformation(model, cloud_of, field_of):
    cloud = cloud_of(9)
    motion = field_of(model, cloud, trained=False)
    for u in (0.0, 0.4, 1.0):
        now = motion.at(cloud, u)
        assert all(
            torch.equal(a, b) for a, b in zip(now, (*list(vars(cloud).values())[:3], now[3], now[4]), strict=True)
        )
        assert torch.equal(now.opacities, cloud.opacity_logits.sigmoid())
        assert torch.equal(now.intensities, cloud.intensities)


@pytest.mark.parametrize("model", MODELS)
def test_a_trained_one_deforms_with_time_what_it_has_heads_for(model, cloud_of, field_of):
    cloud = cloud_of(9)
    motion = field_of(model, cloud)
    first, last = motion.at(cloud, 0.1), motion.at(cloud, 0.9)
    for kind in ("means", "quats_wxyz", "log_scales"):
        assert float((getattr(first, kind) - getattr(last, kind)).abs().amin()) > 1e-6, kind
    for kind, plain in (("opacities", cloud.opacity_logits.sigmoid()), ("intensities", cloud.intensities)):
        assert torch.equal(getattr(last, kind), plain) == (model is SmallHexPlaneMotion), kind


def test_light_changes_in_units_of_the_brightness(cloud_of, field_of):
    cloud = cloud_of(4)
    motion = field_of(HexPlaneMotion, cloud)
    light = motion.offsets(motion.places(cloud.means), 0.3).light
    torch.testing.assert_close(motion.at(cloud, 0.3).intensities, cloud.intensities + 0.3 * light)


def test_a_state_from_before_opacity_and_light_were_deformed_is_read(cloud_of, field_of):
    cloud = cloud_of(4)
    state = DynamicCloud(cloud, cloud, field_of(SmallHexPlaneMotion, cloud), TimeSpan(0.0, 0.02)).state()
    old = {name: tensor for name, tensor in state["tensors"].items() if name != "motion.brightness"}
    back = DynamicCloud.from_state({**state, "model": "4dgs", "tensors": old})
    for a, b in zip(DynamicCloud.from_state(state).at(0.013), back.at(0.013), strict=True):
        assert torch.equal(a, b)


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
        torch.testing.assert_close(motion.offsets(places, u).shift[point], shift, atol=1e-5, rtol=1e-5)


def test_gradients_agree_with_numerical_ones(cloud_of, field_of):
    cloud = GaussianCloud(*(tensor.double() for tensor in vars(cloud_of(3)).values()))
    motion = HexPlaneMotion(**{name: t.double() for name, t in field_of(HexPlaneMotion, cloud_of(3)).tensors()})
    fixed = ("box", "brightness")
    learnt = [t.requires_grad_() for name, t in (*vars(cloud).items(), *motion.tensors()) if name not in fixed]

    def outputs(*tensors):
        model = HexPlaneMotion(motion.box, *tensors[5:], motion.brightness)
        return (*model.at(GaussianCloud(*tensors[:5]), 0.37), model.penalty(cloud))

    assert torch.autograd.gradcheck(outputs, learnt, fast_mode=True)


def test_the_penalty_is_that_of_steps_between_cells_and_nought_for_even_planes(cloud_of, field_of):
    motion = field_of(HexPlaneMotion, cloud_of(4), trained=False)
    motion.coarse_space.fill_(0.3)
    motion.fine_space.fill_(0.2)
    assert float(motion.penalty(cloud_of(4))) == 0
    motion.coarse_time[0, 0, 2, :] = 1.5  # second differences of .5, -1, .5 over three rows of 3 x 2 x 3 x 4
    rough = motion.shape.smooth_time * (0.25 + 1.0 + 0.25) * 4 / (2 * 3 * 4)
    away = hexplane.TIME_ONE * 0.5 * 4 / (2 * 5 * 4)
    assert float(motion.penalty(cloud_of(4))) == pytest.approx(rough + away, rel=1e-5)
    motion.coarse_time.fill_(1.0)
    motion.coarse_space[1, 1, :, 0] = 0.4  # a step along a row, in each of four rows of 2 x 4 x 3
    assert float(motion.penalty(cloud_of(4))) == pytest.approx(2 * motion.shape.smooth_space * 0.01 * 4 / 24, rel=1e-4)


@pytest.mark.parametrize("n", [1, 2])
def test_one_point_or_two_in_one_place_have_a_field(n, cloud_of, field_of):
    cloud = cloud_of(1)
    cloud = GaussianCloud(*(t.repeat(n, *[1] * (t.ndim - 1)) for t in vars(cloud).values()))
    motion = field_of(HexPlaneMotion, cloud)
    low, high = motion.box
    assert float((high - low).amin()) >= 0.2
    assert all(torch.isfinite(t).all() for t in motion.at(cloud, 0.5))
