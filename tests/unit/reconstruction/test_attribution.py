"""Sums of Gaussians' weights over maps of a picture: the kernel against the reference's gradient in float64."""

import pytest
import torch

from acquisition.native import code_path, code_paths
from reconstruction.errors import ReconstructionError
from reconstruction.rendering.native import MOST_MAPS, attribute
from reconstruction.rendering.render import render
from reconstruction.rendering.result import Instantaneous, Rendering
from rigs.camera import Camera
from rigs.transform import Transform


def camera_of(width: int, height: int) -> Camera:
    pose = Transform.looking_at([0.3, -0.2, -2.0], [0.0, 0.0, 0.0])
    return Camera("cam11", width, height, 0.9 * width, 0.88 * width, width / 2 + 0.3, height / 2 - 0.2, pose)


def cloud_of(n: int, log_scale: float = -2.5) -> Instantaneous:
    generator = torch.Generator().manual_seed(n)
    draw = lambda *shape: torch.randn(*shape, generator=generator)  # noqa: E731
    values = 0.8 * draw(n, 3), draw(n, 4), log_scale + 0.6 * draw(n, 3), draw(n).sigmoid(), draw(n, 1).exp()
    return Instantaneous(*values)


def maps_of(count: int, camera: Camera) -> torch.Tensor:
    return torch.randn(count, camera.height, camera.width, generator=torch.Generator().manual_seed(7))


def expected_sums(cloud: Instantaneous, camera: Camera, maps: torch.Tensor) -> torch.Tensor:
    """The gradients of the picture's products with the maps, by intensity: light is linear in it."""
    leaves = Instantaneous(*(t.double() for t in cloud))
    leaves.intensities.requires_grad_()
    light = render(leaves, camera, backend="reference").intensity[..., 0]
    grads = [torch.autograd.grad((light * m.double()).sum(), leaves.intensities, retain_graph=True)[0] for m in maps]
    return torch.cat(grads, dim=1) if len(grads) else torch.zeros(len(cloud.means), 0).double()


@pytest.mark.parametrize("level", ["v2", "v3", "v4", "plain"])
@pytest.mark.parametrize(("width", "height", "count"), [(1, 1, 1), (17, 33, 3), (61, 29, MOST_MAPS), (48, 40, 0)])
def test_the_sums_are_gradients_by_intensity(level, width, height, count):
    if level not in code_paths():
        pytest.skip(f"this processor runs no {level} build")
    cloud, camera = cloud_of(300), camera_of(width, height)
    maps = maps_of(count, camera)
    with code_path(level):
        seen, sums = attribute(cloud, camera, lambda _: maps)
        assert torch.equal(seen.intensity, render(cloud, camera).intensity[..., 0])
    expected = expected_sums(cloud, camera, maps)
    assert sums.shape == (300, count)
    torch.testing.assert_close(sums.double(), expected, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_ones_count_the_pixels_that_each_fills(threads):
    cloud, camera = cloud_of(500, -1.0), camera_of(40, 30)

    def ones(seen: Rendering) -> torch.Tensor:
        return torch.ones_like(seen.alpha)[None]

    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    try:
        seen, filled = attribute(cloud, camera, ones)
    finally:
        torch.set_num_threads(before)
    torch.testing.assert_close(filled.sum(), seen.alpha.sum(), rtol=1e-5, atol=0)
    light = (filled[:, 0] * cloud.intensities[:, 0]).sum()
    torch.testing.assert_close(light, seen.intensity.sum(), rtol=1e-5, atol=0)


def test_what_is_not_seen_has_nothing_to_do_with_the_picture():
    cloud, camera = cloud_of(20), camera_of(24, 20)
    behind = cloud._replace(means=cloud.means - torch.tensor([0.0, 0.0, 50.0]))
    for hidden in (behind, cloud._replace(opacities=torch.zeros(20)), Instantaneous(*(t[:0] for t in cloud))):
        _, sums = attribute(hidden, camera, lambda seen: torch.ones_like(seen.alpha)[None])
        assert sums.shape == (len(hidden.means), 1)
        assert not sums.any()


@pytest.mark.parametrize(
    "maps", [torch.ones(1, 20, 23), torch.ones(MOST_MAPS + 1, 20, 24), torch.ones(1, 20, 24, dtype=torch.float64)]
)
def test_maps_of_another_shape_are_refused(maps):
    with pytest.raises(ReconstructionError, match="found maps"):
        attribute(cloud_of(5), camera_of(24, 20), lambda _: maps)
