import numpy as np
import pytest
import torch

from reconstruction.gaussians.cloud import GaussianCloud
from reconstruction.gaussians.dynamic import DynamicCloud
from reconstruction.gaussians.polynomial import PolynomialMotion
from reconstruction.rendering.render import render
from reconstruction.rendering.result import Rendering
from reconstruction.scene_model import TimeSpan
from reconstruction.training.depth_hold import ConfirmedDepth, DepthHold
from rigs.camera import Camera
from rigs.transform import Transform

HEIGHT, WIDTH = 5, 7
HOLD = DepthHold(0.2)
CAMERA = Camera("cam00", 40, 32, 50.0, 50.0, 20.0, 16.0, Transform.identity())


def rendered(depth: torch.Tensor, alpha: torch.Tensor) -> Rendering:
    return Rendering(torch.zeros(*depth.shape, 1), depth, alpha, torch.zeros(0, dtype=torch.int32))


def images(dtype: torch.dtype) -> tuple[torch.Tensor, torch.Tensor, np.ndarray]:
    """Depth and alpha as leaves, and a map with 0.1 to 30% between it and the light, and some not known."""
    rng = np.random.default_rng(3)
    known = rng.uniform(1.0, 4.0, (HEIGHT, WIDTH)).astype(np.float32)
    alpha = torch.tensor(rng.uniform(0.3, 1.0, (HEIGHT, WIDTH)), dtype=dtype)
    off = torch.tensor(rng.choice([-0.3, -0.03, -0.01, 0.001, 0.01, 0.03, 0.3], (HEIGHT, WIDTH)), dtype=dtype)
    depth = torch.tensor(known, dtype=dtype) * (alpha + off)
    known[rng.random((HEIGHT, WIDTH)) < 0.3] = np.nan
    return depth.requires_grad_(), alpha.requires_grad_(), known


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_value_and_gradient_are_those_of_the_formula(dtype):
    depth, alpha, known = images(dtype)
    loss = HOLD(rendered(depth, alpha), ConfirmedDepth.of(known))
    loss.backward()
    there = known.astype(np.float64)
    off = depth.detach().double().numpy() / there - alpha.detach().double().numpy()
    expected = HOLD.weight * np.nansum(np.minimum(np.abs(off), HOLD.most)) / known.size
    assert float(loss.detach()) == pytest.approx(expected, rel=1e-5)
    pulls = np.where(np.abs(off) < HOLD.most, np.sign(off), 0.0) * HOLD.weight / known.size
    assert set(np.sign(pulls).ravel()) == {-1.0, 0.0, 1.0}
    assert depth.grad is not None
    assert alpha.grad is not None
    assert np.allclose(depth.grad, np.nan_to_num(pulls / there), atol=1e-7)
    assert np.allclose(alpha.grad, -pulls, atol=1e-7)


@pytest.mark.parametrize("value", [np.nan, np.inf, 0.0, -1.0])
def test_what_is_no_depth_is_not_known(value):
    known = np.full((HEIGHT, WIDTH), value, np.float32)
    depth, alpha, _ = images(torch.float32)
    loss = HOLD(rendered(depth, alpha), ConfirmedDepth.of(known))
    loss.backward()
    assert float(loss.detach()) == 0
    assert depth.grad is not None
    assert not depth.grad.any()


def test_a_pixel_without_light_is_not_pulled():
    known = ConfirmedDepth.of(np.full((HEIGHT, WIDTH), 1e-3, np.float32))
    depth, alpha = (torch.zeros(HEIGHT, WIDTH, requires_grad=True) for _ in range(2))
    loss = HOLD(rendered(depth, alpha), known)
    loss.backward()
    assert float(loss.detach()) == 0
    assert depth.grad is not None
    assert not depth.grad.any()


def test_far_away_stays_finite():
    depth = torch.full((HEIGHT, WIDTH), 1e30, requires_grad=True)
    loss = HOLD(rendered(depth, torch.ones(HEIGHT, WIDTH)), ConfirmedDepth.of(np.full((HEIGHT, WIDTH), 1e-30, "f4")))
    loss.backward()
    assert float(loss.detach()) == pytest.approx(HOLD.weight * HOLD.most)
    assert depth.grad is not None
    assert not depth.grad.any()


def test_without_a_mask_leaves_the_other_pixels():
    known = np.arange(1.0, 1 + HEIGHT * WIDTH, dtype=np.float32).reshape(HEIGHT, WIDTH)
    known[0, 0] = np.nan
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[2:] = True
    kept = ConfirmedDepth.of(known).without(mask)
    assert kept.pixels.tolist() == list(range(1, 2 * WIDTH))
    assert kept.depth.tolist() == known.ravel()[1 : 2 * WIDTH].tolist()


def test_it_pulls_layers_of_an_even_wall_together():
    """A picture without texture does not tell two layers half opaque from one wall."""
    rng = np.random.default_rng(0)
    places = np.column_stack([rng.uniform(-1.0, 1.0, 800), rng.uniform(-0.8, 0.8, 800), np.full(800, 2.0)])
    places[::2] *= 1.05
    wall = GaussianCloud.from_points(
        torch.tensor(places, dtype=torch.float32), torch.full((800, 1), 0.5), torch.full((800,), 0.08).log(), 0.4
    )
    cloud = DynamicCloud(
        wall,
        wall.select(torch.zeros(800, dtype=torch.bool)),
        PolynomialMotion.at_rest(torch.zeros(0), 1.0),
        TimeSpan(0.0, 1.0),
    )
    known = ConfirmedDepth.of(np.full((CAMERA.height, CAMERA.width), 2.0, np.float32))

    def off() -> float:
        with torch.no_grad():
            now = render(cloud.at(0.5), CAMERA)
        return float((now.depth - 2.0 * now.alpha).abs().mean())

    before = off()
    wall.means.requires_grad_()
    optimizer = torch.optim.Adam([wall.means], lr=1e-3)
    for _ in range(60):
        optimizer.zero_grad()
        HOLD(render(cloud.at(0.5), CAMERA), known).backward()
        optimizer.step()
    assert before > 0.01
    assert off() < before / 2


def test_no_weight_is_no_loss():
    depth, alpha, known = images(torch.float32)
    assert float(DepthHold(0.0)(rendered(depth, alpha), ConfirmedDepth.of(known)).detach()) == 0
