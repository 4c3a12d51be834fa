"""The torch renderer against what can be worked out by hand."""

import math

import numpy as np
import pytest
import torch

from reconstruction.errors import ReconstructionError
from reconstruction.quaternions import matrices
from reconstruction.rendering.reference import project, render_reference
from reconstruction.rendering.render import render
from reconstruction.rendering.result import Instantaneous
from rigs.camera import Camera
from rigs.transform import Transform

F64 = torch.float64


def camera_of(width: int = 48, height: int = 40, pose: Transform | None = None) -> Camera:
    return Camera("cam11", width, height, 50.0, 48.0, width / 2, height / 2, pose or Transform.identity())


def one(mean, scale=0.1, opacity=0.8, intensity=2.0):
    return (
        torch.tensor([mean], dtype=F64),
        torch.tensor([[1.0, 0, 0, 0]], dtype=F64),
        torch.full((1, 3), math.log(scale), dtype=F64),
        torch.tensor([opacity], dtype=F64),
        torch.tensor([[intensity]], dtype=F64),
    )


def cloud_of(n: int, seed: int = 0) -> tuple[torch.Tensor, ...]:
    generator = torch.Generator().manual_seed(seed)
    draw = lambda *shape: torch.randn(*shape, generator=generator, dtype=F64)  # noqa: E731
    means = torch.cat([0.4 * draw(n, 2), 2 + 0.3 * draw(n, 1)], 1)
    return means, draw(n, 4), -2.5 + 0.3 * draw(n, 3), draw(n).sigmoid(), draw(n, 1).exp()


def test_a_gaussian_before_the_camera_lands_where_a_pinhole_puts_it():
    camera = camera_of()
    x, y, z = 0.3, -0.2, 2.0
    picture = render(one((x, y, z)), camera, backend="reference").intensity[..., 0]
    row, column = np.unravel_index(int(picture.argmax()), picture.shape)
    assert column == int(50 * x / z + 24)
    assert row == int(48 * y / z + 20)


def test_brightness_falls_off_as_the_projected_covariance_says():
    camera, scale, z = camera_of(), 0.1, 2.0
    rendering = render(one((0.5 / 50 * z, 0.5 / 48 * z, z), scale), camera, backend="reference")  # a pixel's centre
    # Next to the axis the slope's share of the Jacobian is 1e-4.
    xx, yy = (50 * scale / z) ** 2, (48 * scale / z) ** 2
    keeps = math.sqrt(xx * yy / ((xx + 0.17) * (yy + 0.17)))
    expected = 0.8 * keeps * math.exp(-0.5 * 9 / (xx + 0.17))
    assert float(rendering.alpha[20, 27]) == pytest.approx(expected, rel=1e-3)
    assert float(rendering.intensity[20, 27, 0]) == pytest.approx(2 * expected, rel=1e-3)
    assert float(rendering.depth[20, 27] / rendering.alpha[20, 27]) == pytest.approx(z)


def test_the_nearer_gaussian_hides_the_farther_one():
    near, far = one((0.01, 0.01, 1.0), 0.3, 0.9, 1.0), one((0.02, 0.02, 2.0), 0.6, 0.9, 5.0)
    both = tuple(torch.cat(pair) for pair in zip(far, near, strict=True))
    camera = camera_of()
    alone = [render(g, camera, backend="reference") for g in (near, far)]
    together = render(both, camera, backend="reference")
    left = 1 - alone[0].alpha
    torch.testing.assert_close(
        together.intensity[..., 0], alone[0].intensity[..., 0] + left * alone[1].intensity[..., 0]
    )
    torch.testing.assert_close(together.alpha, 1 - left * (1 - alone[1].alpha))


def test_moving_camera_and_world_together_changes_nothing():
    gaussians = cloud_of(40)
    quat = np.array([0.9, 0.2, -0.3, 0.1])
    world_from_old = Transform.from_quat_wxyz(quat, [0.5, -1.0, 2.0])
    rotation = torch.tensor(world_from_old.rotation)
    means = gaussians[0] @ rotation.T + torch.tensor(world_from_old.translation)
    q = torch.tensor(quat / np.linalg.norm(quat))
    w, v = q[0], q[1:]
    old_w, old_v = gaussians[1][:, :1], gaussians[1][:, 1:]
    turned = torch.cat(
        [w * old_w - old_v @ v[:, None], w * old_v + old_w * v + torch.linalg.cross(v.expand_as(old_v), old_v)], 1
    )
    first = render(gaussians, camera_of(), backend="reference")
    second = render((means, turned, *gaussians[2:]), camera_of(pose=world_from_old.inverse()), backend="reference")
    torch.testing.assert_close(first.intensity, second.intensity, rtol=1e-7, atol=1e-9)
    torch.testing.assert_close(first.depth, second.depth, rtol=1e-7, atol=1e-9)


def test_rotations_are_those_of_the_rig():
    quats = cloud_of(10)[1]
    for quat, rotation in zip(quats.numpy(), matrices(quats).numpy(), strict=True):
        np.testing.assert_allclose(rotation, Transform.from_quat_wxyz(quat, [0, 0, 0]).rotation, atol=1e-12)


def test_the_background_shows_where_nothing_is():
    gaussians, camera = cloud_of(30), camera_of()
    plain = render(gaussians, camera, backend="reference")
    lit = render(gaussians, camera, backend="reference", background=3.0)
    torch.testing.assert_close(lit.intensity[..., 0], plain.intensity[..., 0] + 3 * (1 - plain.alpha))


def test_channels_are_rendered_alike():
    *shape, intensities = cloud_of(30)
    camera = camera_of()
    single = render((*shape, intensities), camera, backend="reference").intensity
    double = render((*shape, torch.cat([2 * intensities, intensities], 1)), camera, backend="reference").intensity
    torch.testing.assert_close(double, torch.cat([2 * single, single], -1))


def test_the_order_of_the_gaussians_does_not_matter():
    gaussians, camera = cloud_of(60), camera_of()
    order = torch.randperm(60, generator=torch.Generator().manual_seed(1))
    first = render(gaussians, camera, backend="reference")
    second = render(tuple(t[order] for t in gaussians), camera, backend="reference")
    torch.testing.assert_close(first.intensity, second.intensity, rtol=1e-12, atol=1e-14)
    assert (first.radii[order] == second.radii).all()


def test_blocks_of_rows_make_no_difference(monkeypatch):
    gaussians, camera = cloud_of(30), camera_of()
    whole = render_reference(Instantaneous(*gaussians), camera, median=True)
    monkeypatch.setattr("reconstruction.rendering.reference.PAIRS_AT_ONCE", 30 * 48 * 7)
    blocks = render_reference(Instantaneous(*gaussians), camera, median=True)
    for first, second in zip(whole, blocks, strict=True):
        torch.testing.assert_close(first, second, equal_nan=True)


def facing(*layers: tuple[float, float]) -> tuple[torch.Tensor, ...]:
    """Wide Gaussians on the axis of a camera at the origin, by depth and opacity."""
    n = len(layers)
    means = torch.tensor([[0.0, 0.0, z] for z, _ in layers], dtype=F64)
    quats = torch.tensor([[1.0, 0, 0, 0]], dtype=F64).expand(n, 4)
    opacities = torch.tensor([opacity for _, opacity in layers], dtype=F64)
    return means, quats, torch.full((n, 3), 3.0, dtype=F64), opacities, torch.ones(n, 1, dtype=F64)


@pytest.mark.parametrize("backend", ["reference", "native"])
@pytest.mark.parametrize(
    ("layers", "expected"),
    [
        ([], math.nan),
        ([(2.0, 0.4)], math.nan),
        ([(2.0, 0.6)], 2.0),
        ([(2.0, 0.4), (3.0, 0.4)], 3.0),
        ([(3.0, 0.9), (2.0, 0.4)], 3.0),
        ([(2.0, 1.0), (3.0, 1.0)], 2.0),
        ([(2.0, 0.2), (3.0, 0.2), (4.0, 0.2)], math.nan),
        ([(2.0 + 0.01 * i, 0.01) for i in range(200)], 2.68),
    ],
)
def test_the_median_depth_is_that_of_the_layer_that_takes_the_light_to_a_half(backend, layers, expected):
    gaussians = facing(*layers) if layers else tuple(t[:0] for t in facing((1.0, 0.5)))
    dtype = F64 if backend == "reference" else torch.float32
    rendering = render(tuple(t.to(dtype) for t in gaussians), camera_of(), backend=backend, median=True)
    assert float(rendering.median[20, 24]) == pytest.approx(expected, abs=1e-6, nan_ok=True)
    assert (rendering.median.isnan() == (rendering.alpha < 0.5)).all()


@pytest.mark.parametrize("backend", ["reference", "native"])
def test_no_median_depth_is_found_unasked_and_none_has_a_gradient(backend):
    dtype = F64 if backend == "reference" else torch.float32
    leaves = tuple(t.to(dtype).clone().requires_grad_() for t in cloud_of(9))
    assert render(leaves, camera_of(), backend=backend).median is None
    rendering = render(leaves, camera_of(), backend=backend, median=True)
    assert not rendering.median.requires_grad
    rendering.intensity.sum().backward()
    assert leaves[0].grad.abs().sum() > 0


def test_gradients_are_those_of_the_values():
    camera = camera_of(9, 7)
    camera = Camera("cam11", 9, 7, 12.0, 11.0, 4.5, 3.5, camera.cam_from_rig)
    means, quats, log_scales, opacities, intensities = cloud_of(4, seed=3)
    # Wide and faint: no pixel comes near the cut at 1/255, where the image jumps.
    inputs = (means, quats, log_scales + 3, 0.3 + 0.3 * opacities, intensities)
    leaves = tuple(t.clone().requires_grad_() for t in inputs)
    assert len(project(*inputs[:4], camera).source) == 4
    assert torch.autograd.gradcheck(
        lambda *g: render_reference(Instantaneous(*g), camera)[:3], leaves, eps=1e-7, atol=1e-5
    )


def test_what_cannot_be_rendered_is_refused():
    gaussians, camera = cloud_of(3), camera_of()
    with pytest.raises(ReconstructionError, match="opacities of shape"):
        render((*gaussians[:3], gaussians[3][:2], gaussians[4]), camera, backend="reference")
    with pytest.raises(ReconstructionError, match="beyond"):
        render((*gaussians[:3], gaussians[3] * 5, gaussians[4]), camera, backend="reference")
    with pytest.raises(ReconstructionError, match="float32"):
        render(gaussians, camera)
    with pytest.raises(ReconstructionError, match="near plane"):
        render(gaussians, camera, backend="reference", near_m=0.0)
    for dilation in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(ReconstructionError, match="dilation"):
            render(gaussians, camera, backend="reference", dilation_px2=dilation)
    bent = Camera("cam02", 48, 40, 50.0, 48.0, 24.0, 20.0, Transform.identity(), (0.1, 0, 0, 0))
    with pytest.raises(ReconstructionError, match=r"cam02.*distortion"):
        render(gaussians, bent, backend="reference")
