"""gsplat: what is asked of it, and on a machine that has it, that it agrees with the reference."""

import pytest
import torch

from reconstruction.errors import ReconstructionError
from reconstruction.rendering import gsplat_backend
from reconstruction.rendering.reference import render_reference
from reconstruction.rendering.render import NAMES, render
from reconstruction.rendering.result import Guards, Instantaneous
from rigs.camera import Camera
from rigs.transform import Transform

MISSING = gsplat_backend.why_unavailable()


def camera_of() -> Camera:
    pose = Transform.looking_at([0.3, -0.2, -2.0], [0.0, 0.0, 0.0])
    return Camera("cam11", 61, 44, 55.0, 54.0, 30.0, 21.0, pose)


def cloud_of(n: int = 200) -> tuple[torch.Tensor, ...]:
    generator = torch.Generator().manual_seed(0)
    draw = lambda *shape: torch.randn(*shape, generator=generator)  # noqa: E731
    # Below the two caps of alpha, which differ.
    return 0.8 * draw(n, 3), draw(n, 4), -2.5 + 0.6 * draw(n, 3), 0.9 * draw(n).sigmoid(), draw(n, 1).exp()


def as_gsplat(means, quats, scales, opacities, colors, viewmats, Ks, width, height, near_plane, eps2d, **options):
    """The reference behind gsplat's signature."""
    assert options == {"packed": False, "render_mode": "RGB+D", "rasterize_mode": "antialiased"}
    pose, K = viewmats[0].double(), Ks[0].double()
    (fx, _, cx), (_, fy, cy) = K[:2].tolist()
    camera = Camera("cam11", width, height, fx, fy, cx, cy, Transform(pose[:3, :3].numpy(), pose[:3, 3].numpy()))
    gaussians = Instantaneous(means, quats, scales.log(), opacities, colors)
    intensity, depth, alpha, radii, _ = render_reference(gaussians, camera, Guards(near_plane, eps2d))
    colours = torch.cat([intensity, depth[..., None]], -1)[None]
    return colours, alpha[None, ..., None], {"radii": radii[None, :, None].expand(-1, -1, 2)}


@pytest.fixture
def stand_in(monkeypatch):
    monkeypatch.setattr(gsplat_backend, "_rasterization", lambda: as_gsplat)
    monkeypatch.setattr(gsplat_backend, "DEVICE", "cpu")


@pytest.mark.parametrize("channels", [1, 3])
def test_what_is_asked_of_gsplat_is_what_the_reference_renders(stand_in, channels):
    *geometry, intensity = cloud_of()
    gaussians = (*geometry, intensity * torch.arange(1, channels + 1))
    found = render(gaussians, camera_of(), backend="gsplat", background=0.2)
    expected = render(gaussians, camera_of(), backend="reference", background=0.2)
    assert found.intensity.shape == (44, 61, channels)
    for name in ("intensity", "depth", "alpha"):
        torch.testing.assert_close(getattr(found, name), getattr(expected, name), rtol=1e-5, atol=1e-5)
    assert (found.radii == expected.radii).all()


def test_no_gaussians_need_no_gsplat_call(stand_in):
    leaves = tuple(t.requires_grad_() for t in cloud_of(0))
    found = render(leaves, camera_of(), backend="gsplat", background=0.2)
    found.intensity.sum().backward()
    assert (found.intensity == 0.2).all()
    assert leaves[4].grad is not None


def test_tensors_on_the_cpu_are_refused(monkeypatch):
    monkeypatch.setattr(gsplat_backend, "_rasterization", lambda: as_gsplat)
    with pytest.raises(ReconstructionError, match="expected float32 on a CUDA device"):
        render(cloud_of(), camera_of(), backend="gsplat")


@pytest.mark.skipif(MISSING is None, reason="gsplat and a CUDA device are here")
def test_where_gsplat_cannot_run_the_error_says_why():
    with pytest.raises(ReconstructionError, match=r"found no gsplat backend: .*native"):
        render(cloud_of(), camera_of(), backend="gsplat")


@pytest.mark.gpu
@pytest.mark.skipif(MISSING is not None, reason=str(MISSING))
def test_gsplat_agrees_with_the_reference():
    outcomes = []
    for backend, device, dtype in (("gsplat", "cuda", torch.float32), ("reference", "cpu", torch.float64)):
        leaves = tuple(t.to(device, dtype).requires_grad_() for t in cloud_of())
        rendering = render(leaves, camera_of(), backend=backend)
        images = (rendering.intensity, rendering.depth, rendering.alpha)
        torch.stack([image.square().mean() for image in images]).sum().backward()
        outcomes.append(([t.detach().cpu().double() for t in images], [t.grad.cpu().double() for t in leaves]))
    (images, slopes), (expected_images, expected_slopes) = outcomes
    for found, expected in zip(images, expected_images, strict=True):
        torch.testing.assert_close(found, expected, rtol=1e-4, atol=2e-4)
    for name, found, expected in zip(NAMES, slopes, expected_slopes, strict=True):
        scale = float(expected.abs().max())
        assert float((found - expected).abs().max()) / scale < 2e-3, name


def test_a_median_depth_is_refused(stand_in):
    with pytest.raises(ReconstructionError, match="median depth"):
        render(cloud_of(), camera_of(), backend="gsplat", median=True)
