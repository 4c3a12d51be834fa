"""Radiance fields: the march against an analytic integral and its twin, gradients, extremes, frustum and state."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from reconstruction.errors import ReconstructionError
from reconstruction.gaussians.hexplane import Offsets
from reconstruction.radiance_fields.cells import seed_cells
from reconstruction.radiance_fields.frustum import MARGIN, MOST_LAYERS, Frustum
from reconstruction.radiance_fields.march import march, march_reference
from reconstruction.radiance_fields.radiance_field import REACH, RadianceField, ShiftField, grid_of
from reconstruction.scene_model import TimeSpan
from reconstruction.training.checkpoint import model_from_state
from rigs.camera import Camera
from rigs.transform import Transform

SHAPE = (20, 24, 12)  # rows, columns, layers
CLIP = TimeSpan(0.0, 0.02)
NO_SHIFT = torch.zeros(1, 1, 1, 3)


def camera(name: str, x_m: float) -> Camera:
    return Camera(name, 32, 20, 40.0, 40.0, 16.0, 10.0, Transform(np.eye(3), np.array([-x_m, 0.0, 0.0])))


CAMERAS = [camera("cam00", -0.2), camera("cam01", 0.0), camera("cam02", 0.2)]


def wall(depth_m: float, intensity: float, size: int = 40) -> tuple[np.ndarray, np.ndarray]:
    across, down = np.meshgrid(np.linspace(-1.2, 1.2, 2 * size), np.linspace(-0.8, 0.8, size))
    spots = np.stack([across.ravel(), down.ravel(), np.full(across.size, depth_m)], axis=1)
    return spots, np.full(across.size, intensity, np.float32)


NOTHING = (np.zeros((0, 3)), np.zeros(0, np.float32))


def full_grid(raw: float, intensity: float):
    count = math.prod(SHAPE)
    grids = (grid_of(torch.arange(count), 0, SHAPE, (0, 0, 0)),)
    return grids, (torch.full((count,), raw), torch.full((count,), intensity), NO_SHIFT)


def ray(stretch: float = 1.0, x: float = 10.3) -> torch.Tensor:
    return torch.tensor([[x, 9.6, 0.2, -0.1, stretch, 0.0]])


def random_case(seed: int):
    generator = torch.Generator().manual_seed(seed)
    order = torch.randperm(math.prod(SHAPE), generator=generator)
    still, moving = order[:2500].sort().values, order[3000:4500].sort().values
    grids = (grid_of(still, 0, SHAPE, (0, 0, 0)), grid_of(moving, 2500, SHAPE, REACH))
    rest = [torch.rand(200, generator=generator) for _ in range(6)]
    lines = torch.stack(
        [rest[0] * 23, rest[1] * 19, rest[2] - 0.5, rest[3] - 0.5, 1 + 0.2 * rest[4], 2 * rest[5]], dim=1
    )
    jitter = torch.rand(200, generator=generator)
    tensors = (
        torch.randn(4000, generator=generator) - 2,
        torch.rand(4000, generator=generator),
        0.7 * torch.randn(3, 3, 3, 3, generator=generator),
    )
    return grids, lines, jitter, tensors


@pytest.mark.parametrize("stretch", [1.0, 1.3])
def test_a_slab_of_constant_density_takes_light_as_beer_and_lambert_say(stretch):
    grids, tensors = full_grid(-1.0, 0.4)
    seen = march(grids, ray(stretch), torch.zeros(1), 1.0, tensors)
    thickness = (SHAPE[2] - 1) * math.log1p(math.exp(-1.0)) * stretch
    assert float(seen.alpha) == pytest.approx(1 - math.exp(-thickness), abs=1e-6)
    assert float(seen.light) == pytest.approx(0.4 * (1 - math.exp(-thickness)), abs=1e-6)
    assert float(seen.middle) == pytest.approx(math.log(2) / (math.log1p(math.exp(-1.0)) * stretch), abs=1e-5)


def test_finer_steps_see_the_same_slab():
    grids, tensors = full_grid(-1.0, 0.4)
    coarse, fine = (march(grids, ray(), torch.zeros(1), step, tensors) for step in (1.0, 0.25))
    assert float(coarse.light) == pytest.approx(float(fine.light), abs=1e-6)
    assert float(coarse.middle) == pytest.approx(float(fine.middle), abs=1e-4)


@pytest.mark.parametrize("seed", range(3))
def test_the_kernel_and_its_twin_agree_in_values_and_gradients(seed):
    grids, lines, jitter, tensors = random_case(seed)
    found = []
    for function, kind in ((march, torch.float32), (march_reference, torch.float64)):
        leaves = tuple(t.to(kind).clone().requires_grad_() for t in tensors)
        seen = function(grids, lines, jitter, 1.0, leaves)
        weights = torch.linspace(-1, 1, len(lines), dtype=kind)
        (seen.light * weights + seen.alpha * weights.flip(0)).sum().backward()
        found.append([seen.light, seen.alpha, *(leaf.grad for leaf in leaves)])
    for own, twin in zip(*found, strict=True):
        torch.testing.assert_close(own.double(), twin, atol=1e-5, rtol=2e-5)  # 5e-6 seen


def test_gradients_of_the_twin_are_those_of_differences():
    grids, lines, jitter, tensors = random_case(7)
    leaves = tuple(t.double().requires_grad_() for t in tensors)
    few = slice(0, 4)

    def light(*values: torch.Tensor) -> torch.Tensor:
        return march_reference(grids, lines[few], jitter[few], 1.0, values).light

    direction = [torch.randn(t.shape, dtype=torch.float64, generator=torch.Generator().manual_seed(1)) for t in leaves]
    light(*leaves).sum().backward()
    slope = sum(float((leaf.grad * d).sum()) for leaf, d in zip(leaves, direction, strict=True))
    h = 1e-6
    with torch.no_grad():
        ahead, behind = (light(*(t + s * h * d for t, d in zip(leaves, direction, strict=True))).sum() for s in (1, -1))
    assert slope == pytest.approx(float(ahead - behind) / (2 * h), rel=1e-5)


@pytest.mark.parametrize(("raw", "alpha"), [(-1e4, 0.0), (1e4, 1.0)])
def test_no_density_and_all_density_stay_finite(raw, alpha):
    grids, tensors = full_grid(raw, 0.4)
    leaves = tuple(t.clone().requires_grad_() for t in tensors)
    seen = march(grids, ray(), torch.full((1,), 0.5), 1.0, leaves)
    (seen.light + seen.alpha).sum().backward()
    assert seen.alpha.item() == pytest.approx(alpha, abs=1e-6)
    assert all(bool(leaf.grad.isfinite().all()) for leaf in leaves if leaf.grad is not None)
    assert bool(seen.middle.isnan()) == (alpha == 0)


@pytest.mark.parametrize("x", [-5.0, 1e9, -1e9, float("nan")])
def test_a_ray_that_misses_sees_nothing(x):
    grids, tensors = full_grid(1.0, 0.4)
    seen = march(grids, ray(x=x), torch.zeros(1), 1.0, tensors)
    assert float(seen.light) == float(seen.alpha) == 0
    assert bool(seen.middle.isnan())


def test_no_rays_at_all():
    grids, tensors = full_grid(1.0, 0.4)
    assert len(march(grids, torch.zeros(0, 6), torch.zeros(0), 1.0, tensors).light) == 0


def test_one_sample_is_one_layer():
    grids, tensors = full_grid(0.0, 0.5)
    line = torch.tensor([[10.0, 9.0, 0.0, 0.0, 1.0, SHAPE[2] - 1.5]])
    seen = march(grids, line, torch.zeros(1), 1.0, tensors)
    assert float(seen.alpha) == pytest.approx(0.5, abs=1e-6)  # exp(-log 2)


def test_nodes_and_positions_are_inverse_and_rays_meet_what_they_look_at():
    spots, _ = wall(2.0, 0.3)
    frustum = Frustum.around(spots, CAMERAS)
    nodes = frustum.nodes(spots)
    np.testing.assert_allclose(frustum.positions(nodes), spots, atol=1e-9)
    rays = frustum.rays(CAMERAS[2], np.array([5]), np.array([3]))
    x, y, dx, dy, *_ = rays.lines[0].double().tolist()
    pixel = np.array([(5.5 - 16) / 40, (3.5 - 10) / 40, 1.0]) * 2.0 + CAMERAS[2].center
    row, column, layer = frustum.nodes(pixel[None])[0]
    assert (y + layer * dy, x + layer * dx) == (pytest.approx(row, abs=1e-3), pytest.approx(column, abs=1e-3))
    assert float(frustum.depths(rays, torch.tensor([layer]))) == pytest.approx(2.0, abs=1e-6)


@pytest.mark.parametrize("far_m", [20.0, 1e3, 1e9])
def test_what_is_far_adds_no_layers_without_end(far_m):
    (near, _), (far, _) = wall(2.0, 0.3), wall(far_m, 0.3)
    frustum = Frustum.around(np.concatenate([near, far]), CAMERAS)
    assert frustum.shape[2] <= MOST_LAYERS + 2 * MARGIN + 1
    assert (frustum.nodes(near)[:, 2] >= 0).all()


@pytest.mark.parametrize("view", CAMERAS, ids=lambda c: c.id)
def test_a_seeded_wall_is_seen_where_it_is_and_as_bright(view):
    field = seed_cells(wall(2.0, 0.3), NOTHING, CLIP, CAMERAS)
    seen = field.look(view, 0.01)
    middle = (slice(6, 14), slice(10, 22))
    np.testing.assert_allclose(1 / seen.depth[middle], 1 / 2.0, atol=0.75 * field.frustum.step)  # within a layer
    np.testing.assert_allclose(seen.intensity[middle], 0.3, atol=0.03)


def test_one_pixel_is_a_picture():
    field = seed_cells(wall(2.0, 0.3), NOTHING, CLIP, CAMERAS)
    assert field.look(CAMERAS[1].scaled(1, 1), 0.01).depth.shape == (1, 1)


def test_light_that_flickers_dims_the_picture():
    field = replace(seed_cells(wall(2.0, 0.3), NOTHING, CLIP, CAMERAS), light=torch.tensor([1.0, 0.5]))
    bright, dim = (field.look(CAMERAS[1], s).intensity for s in (0.0, 0.019))
    np.testing.assert_allclose(dim, bright / 2, rtol=1e-5)


def test_the_deformation_moves_what_moves(monkeypatch):
    field = seed_cells(wall(3.0, 0.1), (wall(2.0, 0.5)[0] * [0.1, 0.1, 1], wall(2.0, 0.5)[1]), CLIP, CAMERAS)
    left = torch.tensor([0.0, -4.0 / (field.frustum.shape[1] / 2), 0.0])  # four columns, in halves of the box
    monkeypatch.setattr(ShiftField, "offsets", lambda self, places, u: Offsets(u * left.expand(len(places), 3)))
    early, late = (field.look(CAMERAS[1], s).intensity for s in (0.0, 0.02))
    columns = np.arange(32)
    places = [float((columns * (v > 0.3)).sum() / (v > 0.3).sum()) for v in (early, late)]
    assert places[1] - places[0] == pytest.approx(4.0, abs=0.5)


def test_the_deformation_is_that_of_4dgs_at_every_knot_and_is_learnt():
    field = seed_cells(wall(3.0, 0.1), wall(2.0, 0.5), CLIP, CAMERAS)
    field.shifts.heads.normal_(0, 0.05, generator=torch.Generator().manual_seed(1)).requires_grad_()
    *_, offsets = field.at(0.003)
    rows, columns, layers = field.frustum.shape
    place = torch.tensor([[2 * 16 / rows - 1, 2 * 16 / columns - 1, 2 * 8 / layers - 1]]).clamp(-1, 1)
    expected = field.shifts.offsets(place, 0.15).shift[0] * torch.tensor(field.frustum.shape) / 2
    torch.testing.assert_close(offsets[1, 1, 1], expected)
    offsets.sum().backward()
    assert float(field.shifts.heads.grad.abs().sum()) > 0


def test_state_comes_back_whole_and_strange_tensors_are_refused():
    field = seed_cells(wall(3.0, 0.1), wall(2.0, 0.5), CLIP, CAMERAS)
    state = field.state()
    back = model_from_state(state)
    assert isinstance(back, RadianceField)
    np.testing.assert_array_equal(back.look(CAMERAS[0], 0.01).intensity, field.look(CAMERAS[0], 0.01).intensity)
    assert len(back) == len(field) == len(field.positions(0.0))
    still = seed_cells(wall(2.0, 0.3), NOTHING, CLIP, CAMERAS)
    assert model_from_state(still.state()).shifts is None
    with pytest.raises(ReconstructionError, match="train again"):
        model_from_state(state | {"tensors": {"field.colours": torch.zeros(1)}})


def test_neighbours_that_are_alike_vary_by_nothing():
    field = seed_cells(wall(2.0, 0.3), NOTHING, CLIP, CAMERAS)
    field.densities.zero_()
    field.intensities.fill_(0.3)
    cells = torch.arange(len(field))
    assert float(field.variation(cells)) == 0
    field.intensities[::2] = 0.2
    assert float(field.variation(cells)) > 0
