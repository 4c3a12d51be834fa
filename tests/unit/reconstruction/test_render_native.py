"""The native renderer against the torch reference in float64: values, gradients, order, threads."""

import gc

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from acquisition.native import code_path, code_paths
from reconstruction.errors import ReconstructionError
from reconstruction.rendering.native import work_of
from reconstruction.rendering.reference import TRANSMITTANCE_MIN, alphas_of, project, transmittance_before
from reconstruction.rendering.render import NAMES, render
from reconstruction.rendering.result import Instantaneous, Rendering
from rigs.camera import Camera
from rigs.transform import Transform

SIZES = [(1, 1), (5, 3), (16, 16), (17, 33), (48, 40), (61, 29), (100, 8)]


def camera_of(width: int, height: int) -> Camera:
    pose = Transform.looking_at([0.3, -0.2, -2.0], [0.0, 0.0, 0.0])
    return Camera("cam11", width, height, 0.9 * width, 0.88 * width, width / 2 + 0.3, height / 2 - 0.2, pose)


def cloud_of(n: int, seed: int = 0, log_scale: float = -2.5) -> tuple[torch.Tensor, ...]:
    generator = torch.Generator().manual_seed(seed)
    draw = lambda *shape: torch.randn(*shape, generator=generator)  # noqa: E731
    return 0.8 * draw(n, 3), draw(n, 4), log_scale + 0.6 * draw(n, 3), draw(n).sigmoid(), draw(n, 1).exp()


def rendered(gaussians, camera, backend, **options) -> tuple[Rendering, list[torch.Tensor]]:
    """The rendering and the gradients of a random linear function of all three images, as float64."""
    dtype = torch.float32 if backend == "native" else torch.float64
    leaves = tuple(t.to(dtype).clone().requires_grad_() for t in gaussians)
    rendering = render(leaves, camera, backend=backend, **options)
    generator = torch.Generator().manual_seed(5)
    loss = torch.zeros((), dtype=dtype)
    for image in (rendering.intensity, rendering.depth, rendering.alpha):
        loss = loss + (torch.randn(image.shape, generator=generator).to(dtype) * image).sum()
    loss.backward()
    return rendering, [torch.zeros(0) if t.grad is None else t.grad.double() for t in leaves]


def assert_alike(gaussians, camera, **options) -> None:
    (native, native_grads), (reference, reference_grads) = (
        rendered(gaussians, camera, backend, **options) for backend in ("native", "reference")
    )
    assert (native.radii == reference.radii).all()
    for image in ("intensity", "depth", "alpha"):
        expected = getattr(reference, image).detach()
        torch.testing.assert_close(getattr(native, image).detach().double(), expected, rtol=1e-5, atol=1e-5)
    for name, got, expected in zip(NAMES, native_grads, reference_grads, strict=True):
        scale = max(float(expected.abs().max()), 1e-6)
        worst = float((got - expected).abs().max()) / scale
        assert worst < 1e-4, f"{name}: {worst}"  # worst measured 1.6e-5, of the quaternions


@pytest.mark.parametrize(("width", "height"), SIZES)
def test_values_and_gradients_agree_at_sizes_that_are_not_whole_tiles(width, height):
    assert_alike(cloud_of(200), camera_of(width, height))


@pytest.mark.parametrize("dilation_px2", [1e-6, 0.14, 20.0])
def test_values_and_gradients_agree_whatever_is_added_to_splats(dilation_px2):
    assert_alike(cloud_of(120, 1, -3.5), camera_of(40, 28), dilation_px2=dilation_px2)


@pytest.mark.parametrize("log_scale", [-4.0, -3.0, -1.5, 0.0])
def test_values_and_gradients_agree_for_small_and_large_gaussians(log_scale):
    assert_alike(cloud_of(120, 1, log_scale), camera_of(40, 28))


@pytest.mark.parametrize(("width", "height"), SIZES)
def test_median_depths_agree_but_where_rounding_decides(width, height):
    gaussians, camera = cloud_of(250, 7, -1.5), camera_of(width, height)
    plain, native = render(gaussians, camera), render(gaussians, camera, median=True)
    reference = render(tuple(t.double() for t in gaussians), camera, backend="reference", median=True)
    assert (plain.intensity == native.intensity).all()
    assert native.median is not None
    assert reference.median is not None
    known = ~reference.median.isnan()
    assert known.any()
    unlike = (known != ~native.median.isnan()) | ((native.median.double() - reference.median).abs() > 1e-5)
    assert int(unlike.sum()) <= width * height // 1000  # none measured


@settings(max_examples=25, deadline=None)
@given(st.integers(1, 40), st.integers(1, 40), st.integers(1, 70), st.integers(0, 10**6))
def test_values_agree_for_any_size_and_number(width, height, n, seed):
    gaussians, camera = cloud_of(n, seed), camera_of(width, height)
    native = render(gaussians, camera)
    reference = render(tuple(t.double() for t in gaussians), camera, backend="reference")
    # A pixel whose alpha is 1/255 to within rounding may fall on either side of the cut.
    brightest = float(gaussians[4].max())
    difference = (native.intensity.double() - reference.intensity).abs()
    assert float(difference.max()) < brightest / 200
    assert float(difference.median()) < 1e-5 * brightest


def test_many_layers_of_faint_gaussians_agree():
    means, quats, log_scales, opacities, intensities = cloud_of(600, 2, -1.0)
    assert_alike((means, quats, log_scales, 0.02 + 0.05 * opacities, intensities), camera_of(20, 18))


def test_opaque_layers_end_where_no_light_is_left():
    means, quats, log_scales, opacities, intensities = cloud_of(400, 3, -0.5)
    gaussians = (means, quats, log_scales, 0.9 + 0.1 * opacities, intensities)
    assert_alike(gaussians, camera_of(33, 21))
    # Pixels stop below 1e-4; the last splat before may take another 99%.
    assert float(1 - render(gaussians, camera_of(33, 21)).alpha.max()) >= 9e-7


@pytest.mark.parametrize("level", ["v2", "v3", "v4", "plain"])
def test_every_build_this_processor_runs_agrees(level):
    if level not in code_paths():
        pytest.skip(f"this processor runs no {level} build")
    with code_path(level):
        assert_alike(cloud_of(300, 4), camera_of(57, 43))
        assert_alike(cloud_of(90, 5, -0.5), camera_of(33, 21))


def test_three_channels_are_three_images_of_one_cloud():
    *geometry, intensity = cloud_of(150)
    assert_alike((*geometry, intensity * torch.tensor([1.0, 0.5, 3.0])), camera_of(31, 26))


def test_no_channel_is_refused():
    *geometry, intensity = cloud_of(5)
    with pytest.raises(ReconstructionError, match="0 channels"):
        render((*geometry, intensity[:, :0]), camera_of(8, 8))


@pytest.mark.parametrize("log_scale", [-3.0, -1.0])
def test_the_work_is_counted_as_the_reference_would(log_scale):
    cloud, camera = cloud_of(80, 6, log_scale), camera_of(37, 22)
    work = work_of(Instantaneous(*cloud), camera)
    splats = project(*(t.double() for t in cloud[:4]), camera)
    y, x = torch.meshgrid(torch.arange(22) + 0.5, torch.arange(37) + 0.5, indexing="ij")
    alphas = alphas_of(splats, torch.stack([x, y], -1).reshape(-1, 2).double())
    live = transmittance_before(alphas)[:, :-1] >= TRANSMITTANCE_MIN
    assert work.splats == len(splats.source)
    assert work.pixels == int(((alphas > 0) & live).sum())
    assert work.pixels <= 16 * work.in_blocks <= 256 * work.in_tiles


def test_the_background_passes_a_gradient_to_the_gaussians():
    assert_alike(cloud_of(100), camera_of(24, 20), background=0.7)


@pytest.mark.parametrize("image", ["intensity", "depth", "alpha"])
def test_one_image_alone_can_be_differentiated(image):
    grads = []
    for backend, dtype in (("native", torch.float32), ("reference", torch.float64)):
        leaves = tuple(t.to(dtype).requires_grad_() for t in cloud_of(50))
        getattr(render(leaves, camera_of(24, 20), backend=backend), image).square().sum().backward()
        grads.append([torch.zeros_like(t) if t.grad is None else t.grad for t in leaves])
    for got, expected in zip(*grads, strict=True):
        scale = max(float(expected.abs().max()), 1e-6)
        torch.testing.assert_close(got.double() / scale, expected / scale, rtol=0, atol=1e-4)


def test_the_order_of_the_gaussians_does_not_matter():
    gaussians, camera = cloud_of(300), camera_of(50, 30)
    order = torch.randperm(300, generator=torch.Generator().manual_seed(1))
    first, first_grads = rendered(gaussians, camera, "native")
    second, second_grads = rendered(tuple(t[order] for t in gaussians), camera, "native")
    assert (first.intensity == second.intensity).all()
    assert (first.radii[order] == second.radii).all()
    for got, expected in zip(second_grads, first_grads, strict=True):
        torch.testing.assert_close(got, expected[order], rtol=1e-6, atol=1e-6)


def test_the_same_bits_come_out_each_time_and_for_any_number_of_threads():
    gaussians, camera = cloud_of(500), camera_of(90, 70)
    before = torch.get_num_threads()
    try:
        runs = []
        for threads in (1, 2, 2, 3):
            torch.set_num_threads(threads)
            runs.append(rendered(gaussians, camera, "native"))
    finally:
        torch.set_num_threads(before)
    for rendering, grads in runs[1:]:
        assert (rendering.intensity == runs[0][0].intensity).all()
        assert all((a == b).all() for a, b in zip(grads, runs[0][1], strict=True))


def test_two_renderings_may_be_alive_at_once():
    gaussians = cloud_of(80)
    leaves = tuple(t.clone().requires_grad_() for t in gaussians)
    cameras = [camera_of(40, 30), camera_of(19, 23)]
    sum(render(leaves, camera).intensity.sum() for camera in cameras).backward()  # type: ignore[union-attr]
    together = leaves[0].grad
    apart = torch.zeros_like(gaussians[0])
    for camera in cameras:
        alone = tuple(t.clone().requires_grad_() for t in gaussians)
        render(alone, camera).intensity.sum().backward()
        assert alone[0].grad is not None
        apart += alone[0].grad
        gc.collect()
    torch.testing.assert_close(together, apart)


def test_tensors_that_are_views_are_read_as_they_are():
    gaussians, camera = cloud_of(60), camera_of(30, 20)
    wide = torch.zeros(60, 7)
    wide[:, 2:5] = gaussians[0]
    rendering = render((wide[:, 2:5], *gaussians[1:]), camera)
    assert (rendering.intensity == render(gaussians, camera).intensity).all()


@pytest.mark.parametrize("backend", ["native", "reference"])
@pytest.mark.parametrize("position", range(5))
@pytest.mark.parametrize("value", [torch.nan, torch.inf])
def test_nan_and_infinity_are_refused_by_name(backend, position, value):
    gaussians = list(cloud_of(9))
    gaussians[position][4] = value
    with pytest.raises(ReconstructionError, match=NAMES[position]):
        render(tuple(gaussians), camera_of(10, 10), backend=backend)


@pytest.mark.parametrize(("width", "height"), SIZES)
@pytest.mark.parametrize("leading", [0, 1, 150, 300])
def test_given_gaussians_are_seen_and_get_no_gradient(width, height, leading):
    gaussians, camera = cloud_of(300), camera_of(width, height)
    whole, all_grads = rendered(gaussians, camera, "native")
    for backend in ("native", "reference"):
        seen, grads = rendered(gaussians, camera, backend, given=leading)
        torch.testing.assert_close(seen.intensity.double(), whole.intensity.double(), rtol=1e-5, atol=1e-5)
        for expected, got in zip(all_grads, grads, strict=True):
            assert not got[:leading].any()
            scale = max(float(expected.abs().max()), 1e-6)
            torch.testing.assert_close(got[leading:] / scale, expected[leading:] / scale, rtol=0, atol=1e-4)
    _, native = rendered(gaussians, camera, "native", given=leading)
    assert all(torch.equal(a[leading:], b[leading:]) for a, b in zip(native, all_grads, strict=True))


def focused(gaussians, camera, pixels, only) -> tuple[Rendering, list[torch.Tensor]]:
    """The rendering, and the gradients of a random linear function of the `pixels` [H, W]."""
    leaves = tuple(t.clone().requires_grad_() for t in gaussians)
    seen = render(leaves, camera, only=only)
    weights = torch.randn(camera.height, camera.width, generator=torch.Generator().manual_seed(3)) * pixels
    (weights * (seen.intensity[..., 0] + seen.depth + seen.alpha)).sum().backward()
    return seen, [t.grad for t in leaves]


@pytest.mark.parametrize(("width", "height"), SIZES)
@pytest.mark.parametrize("share", [0.0, 0.02, 0.3, 1.0])
def test_pixels_alone_are_as_in_the_whole_picture(width, height, share):
    gaussians, camera = cloud_of(300), camera_of(width, height)
    pixels = torch.rand(height, width, generator=torch.Generator().manual_seed(1)) < share
    whole, expected = focused(gaussians, camera, pixels, None)
    part, got = focused(gaussians, camera, pixels, pixels)
    for image in ("intensity", "depth", "alpha"):
        assert torch.equal(getattr(part, image)[pixels], getattr(whole, image)[pixels])
    assert all(torch.equal(a, b) for a, b in zip(got, expected, strict=True))
    if not pixels.any():
        assert not part.alpha.any()
        assert not part.radii.any()
