import numpy as np
import pytest
import torch

from acquisition.scenes.misplaced import misplaced
from acquisition.scenes.random.several_views import random_rig
from reconstruction.errors import BadRunError
from reconstruction.metrics.poses import pose_errors
from reconstruction.networks.msdi.adjustment import Stage, adjust, derivatives, moved
from reconstruction.networks.msdi.features import patch_centers
from reconstruction.networks.msdi.matching import Matches
from reconstruction.networks.msdi.views import GATE, LEAST_Z, Views, gate, homogeneous, object_distance
from rigs.toml import catalog_rig

FREE = (Stage(4, 1e4, 1e-3, 1e-3), Stage(20, 1e4, 100.0, 100.0, 50.0))  # no priors to speak of, no outliers


def scattered(rig, count=80, seed=0):
    """Random pixels of every view with random inverse depths, and all that the other views see of them, exactly."""
    generator = torch.Generator().manual_seed(seed)
    views = Views.of_rig(rig)
    size = torch.tensor([rig.cameras[0].width, rig.cameras[0].height], dtype=torch.float64)
    pixels = torch.rand(len(views), count, 2, generator=generator, dtype=torch.float64) * size
    inverse = 1 / (1 + 2 * torch.rand(len(views), count, generator=generator, dtype=torch.float64))
    found, ratio = views.seen_from(views, pixels, inverse)
    inside = ((found > 0) & (found < size)).all(-1) & (ratio > 0)
    inside &= ~torch.eye(len(views), dtype=torch.bool)[:, None]
    information = inside[..., None, None] * 4 * torch.eye(2, dtype=torch.float64)
    return views, Matches(pixels, found, information), inverse


def test_what_one_view_sees_of_another_is_what_the_rig_says():
    rig = catalog_rig("lab3x3").scaled(200, 125)
    views, matches, inverse = scattered(rig)
    v, n, w = 2, 7, 5
    camera, other = rig.cameras[v], rig.cameras[w]
    x, y = matches.pixels[v, n].numpy()
    ray = np.array([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, 1]) / float(inverse[v, n])
    there = (other.cam_from_rig @ camera.cam_from_rig.inverse()).apply(ray)
    expected = other.K @ there / there[2]
    assert np.allclose(matches.found[v, n, w].numpy(), expected[:2], atol=1e-9)
    ratio = views.seen_from(views, matches.pixels, inverse)[1]
    assert float(ratio[v, n, w]) == pytest.approx(there[2] * float(inverse[v, n]))


def test_a_rig_goes_to_views_and_back():
    rig = random_rig(3, 4, 192, 128)
    back = Views.of_rig(rig, factor=2).to_rig(rig, factor=2)
    for a, b in zip(rig.cameras, back.cameras, strict=True):
        assert np.allclose(a.cam_from_rig.matrix, b.cam_from_rig.matrix, atol=1e-12)
        assert a.fx == pytest.approx(b.fx)


def test_the_object_lies_where_the_axes_meet():
    assert object_distance(catalog_rig("lab3x3")) == pytest.approx(1.81, abs=0.01)
    distances = [object_distance(misplaced(random_rig(seed, 4, 192, 128), 1.0, seed)) for seed in range(40)]
    assert 0.8 < min(distances) < max(distances) < 4
    rig = catalog_rig("lab3x3").only(["cam11"])
    with pytest.raises(BadRunError, match="cameras at one place"):
        object_distance(rig)


def test_derivatives_are_those_of_autograd():
    rig = random_rig(1, 3, 192, 128)
    views, matches, inverse = scattered(rig, count=4)

    def expected(parameters, inverse_depth):
        there = moved(views, parameters)
        seen = homogeneous(there, there, there.directions(matches.pixels), inverse_depth)
        return seen[..., :2] / seen[..., 2:].clamp_min(LEAST_Z) * there.focal + there.principal

    nothing = torch.zeros(6 * len(views) + 1, dtype=torch.float64)
    by_parameters, by_depth = torch.autograd.functional.jacobian(expected, (nothing, inverse))
    seen = homogeneous(views, views, views.directions(matches.pixels), inverse)
    slopes = derivatives(views, matches.pixels, inverse, seen)
    for v in range(len(views)):
        for w in range(len(views)):
            total = torch.zeros(4, 2, 6 * len(views) + 1, dtype=torch.float64)
            total[..., 6 * v : 6 * v + 6] += slopes.own[v, :, w]
            total[..., 6 * w : 6 * w + 6] += slopes.other[v, :, w]
            total[..., -1] = slopes.lens[v, :, w]
            assert torch.allclose(total, by_parameters[v, :, w], atol=1e-7)
            along = torch.stack([by_depth[v, n, w, :, v, n] for n in range(4)])
            assert torch.allclose(slopes.along[v, :, w], along, atol=1e-7)


@pytest.mark.parametrize("views", [3, 4, 9])
def test_exact_correspondences_give_the_exact_rig(views):
    rig = catalog_rig("lab3x3").scaled(200, 125) if views == 9 else random_rig(2, views, 192, 128)
    nominal = misplaced(rig, 2.0, 1)
    matches = scattered(rig)[1]
    found = adjust(Views.of_rig(nominal), matches, FREE)
    errors = pose_errors(found.views.to_rig(nominal), rig, 1.8)
    assert errors.rotation_deg < 1e-3  # worst measured 1e-4
    assert errors.translation_percent < 1e-3
    assert errors.focal_percent < 5e-3  # 1.2e-3
    used = matches.information[..., 0, 0] > 0
    assert torch.equal(found.fits, used)


def test_noise_and_wrong_correspondences_leave_a_twentieth_of_the_nominal_error():
    rig = random_rig(5, 4, 192, 128)
    nominal = misplaced(rig, 2.0, 1)
    matches = scattered(rig, count=200)[1]
    generator = torch.Generator().manual_seed(1)
    noise = 0.5 * torch.randn(matches.found.shape, generator=generator, dtype=torch.float64)
    wrong = torch.rand(matches.found.shape[:-1], generator=generator) < 0.15
    far = 30 * torch.randn(matches.found.shape, generator=generator, dtype=torch.float64)
    found = matches.found + noise + wrong[..., None] * far
    result = adjust(Views.of_rig(nominal), Matches(matches.pixels, found, matches.information))
    before, after = (pose_errors(r, rig, 1.8) for r in (nominal, result.views.to_rig(nominal)))
    assert after.rotation_deg < before.rotation_deg / 20
    assert after.translation_percent < before.translation_percent / 4
    assert result.fits[wrong].float().mean() < 0.2


def test_without_correspondences_the_nominal_rig_stands_and_gradients_are_finite():
    rig = random_rig(5, 3, 192, 128)
    matches = scattered(rig)[1]
    information = torch.zeros_like(matches.information).requires_grad_(True)
    found = adjust(Views.of_rig(rig), Matches(matches.pixels, matches.found, information))
    assert torch.allclose(found.views.rotation, Views.of_rig(rig).rotation)
    found.views.rotation.sum().backward()
    assert information.grad is not None
    assert torch.isfinite(information.grad).all()


def test_gradients_pass_through_the_adjustment():
    rig = random_rig(4, 3, 192, 128)
    matches = scattered(rig, count=12)[1]
    nominal = Views.of_rig(misplaced(rig, 0.5, 2))

    def turn(shift):
        moved_by = matches.found + shift
        return adjust(nominal, Matches(matches.pixels, moved_by, matches.information)).views.rotation[1, 0, 2]

    at = torch.zeros_like(matches.found).requires_grad_(True)
    turn(at).backward()
    assert at.grad is not None
    where = (1, 3, 0, 0) if float(matches.information[1, 3, 0, 0, 0]) > 0 else (0, 3, 1, 0)
    step = torch.zeros_like(matches.found)
    step[where] = 1e-4
    with torch.no_grad():
        numeric = (turn(step) - turn(-step)) / 2e-4
    # The robust weights are held while differentiating, so the two agree in size and sign, not to the digit.
    assert float(at.grad[where]) == pytest.approx(float(numeric), rel=0.2)


def test_the_gate_lets_true_pairs_through_and_keeps_most_others_out():
    rig = random_rig(7, 4, 192, 128)
    nominal = misplaced(rig, 2.0, 3)
    centers = patch_centers((192, 128))
    pixels = centers.expand(4, -1, -1).double()
    true = Views.of_rig(rig)
    seen, _ = true.seen_from(true, pixels, torch.full(pixels.shape[:2], 1 / 1.7, dtype=torch.float64))
    passed = gate(Views.of_rig(nominal).to(torch.float32), pixels.float(), GATE)
    away = (seen[..., None, :] - centers.double()).norm(dim=-1)
    nearest = away.min(dim=-1)
    inside = (nearest.values < 4) & ~torch.eye(4, dtype=torch.bool)[:, None]
    held = passed.gather(-1, nearest.indices[..., None])[..., 0]
    assert held[inside].all()
    assert passed.float().mean() < 0.2
    assert torch.equal(passed, passed.permute(2, 3, 0, 1))
    assert not passed[0, :, 0].any()
