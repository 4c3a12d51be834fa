"""Training views at half the width and height: their pictures, what is known of them, and renders that fit them."""

import numpy as np
import pytest
import torch

from reconstruction.rendering.render import render
from reconstruction.training.view import TrainingView, halved
from rigs.camera import Camera
from rigs.transform import Transform


def camera_of(width: int, height: int) -> Camera:
    pose = Transform.looking_at([0.3, -0.2, -2.0], [0.0, 0.0, 0.0])
    return Camera("cam11", width, height, 0.9 * width, 0.88 * width, width / 2 + 0.3, height / 2 - 0.2, pose)


class Source:
    """Stands in for a source of one image."""

    straightening = None

    def __init__(self, image):
        self.image = image

    def at(self, plane):
        return self.image


def view_of(height: int, width: int, **known) -> TrainingView:
    image = np.random.default_rng(0).random((height, width), dtype=np.float32)
    return TrainingView(camera_of(width, height), Source(image), **known)  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize(("height", "width"), [(2, 2), (6, 4), (7, 9), (33, 18)])
def test_a_pixel_is_the_mean_of_four(height, width):
    view = view_of(height, width)
    picture = view.halved.picture(3)
    assert picture.shape == (height // 2, width // 2) == (view.halved.camera.height, view.halved.camera.width)
    even = view.source.at(3)[: height // 2 * 2, : width // 2 * 2].astype(np.float64)
    expected = even.reshape(height // 2, 2, width // 2, 2).mean(axis=(1, 3))
    np.testing.assert_allclose(picture.numpy(), expected, rtol=1e-6)
    assert view.picture(3).shape == (height, width)


def test_halves_of_halves_are_means_of_sixteen():
    view = view_of(12, 8)
    expected = view.source.at(0).astype(np.float64).reshape(3, 4, 2, 4).mean(axis=(1, 3))
    np.testing.assert_allclose(view.halved.halved.picture(0).numpy(), expected, rtol=1e-6)


def test_the_camera_sees_each_point_at_half_its_place():
    camera = camera_of(9, 7)
    points = np.array([[0.0, 0.0, 0.0], [0.4, 0.1, 0.2]])
    np.testing.assert_allclose(camera.halved().project(points)[0], camera.project(points)[0] / 2)


def test_depth_is_known_and_space_empty_where_all_four_pixels_say_so():
    known = torch.tensor([[1.0, 3.0, 2.0, 2.0], [2.0, 2.0, 0.0, 2.0]])
    empty = torch.tensor([[1.0, 1.0, 0.0, 1.0], [1.0, 1.0, 1.0, 1.0]])
    half = view_of(2, 4, inverse_depth=known, empty=empty).halved
    assert half.inverse_depth is not None
    assert half.empty is not None
    assert half.inverse_depth.tolist() == [[2.0, 0.0]]
    assert half.empty.tolist() == [[1.0, 0.0]]


USUAL_PX2 = 0.3


@pytest.mark.parametrize("halvings", [1, 2])
def test_a_render_is_the_mean_of_the_whole_views_pixels(halvings):
    generator = torch.Generator().manual_seed(0)
    means = 0.5 * torch.randn(60, 3, generator=generator)
    gaussians = (
        means,
        torch.randn(60, 4, generator=generator),
        torch.full((60, 3), -2.3),
        torch.full((60,), 0.4),
        torch.rand(60, 1, generator=generator),
    )
    view, small = view_of(96, 128), view_of(96, 128)
    for _ in range(halvings):
        small = small.halved
    expected = render(gaussians, view.camera, dilation_px2=view.dilation(USUAL_PX2)).intensity[..., 0]
    for _ in range(halvings):
        expected = halved(expected)
    errors = [
        (render(gaussians, small.camera, dilation_px2=dilation).intensity[..., 0] - expected).abs().mean()
        for dilation in (small.dilation(USUAL_PX2), USUAL_PX2, 0.02)
    ]
    assert errors[0] < 0.01 * expected.mean()
    assert errors[0] < 0.6 * min(errors[1:])
