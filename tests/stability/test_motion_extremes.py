"""The stress catalogue's cases 15 to 19 for every motion model: bounded, finite, and the same at any scale."""

import math

import numpy as np
import pytest
import torch

from reconstruction.gaussians.deformation import DeformationMotion
from reconstruction.gaussians.dynamic import Clip, DynamicCloud
from reconstruction.gaussians.hexplane import HexPlaneMotion
from reconstruction.initialization.bodies import Bodies
from reconstruction.initialization.points import Points
from reconstruction.methods.seeding import seed_cloud, seed_field, seed_rigid, seed_spacetime, seed_timesteps

CLIP = Clip(0.0, 0.02)
MODELS = ("linear", "cubic", "bases", "4dgs", "deformation", "stg", "d3dgs")
FIELDS = ("4dgs", "deformation")
LASTING = (*FIELDS, "d3dgs")  # without a window of time
INSTANTS = 8


def cloud_of(model: str, scale: float = 1.0) -> DynamicCloud:
    """Six points at eight instants, four of them on a body that turns half a circle, with numbers in every tensor."""
    rng = np.random.default_rng(0)
    times = np.repeat((np.arange(INSTANTS) + 0.5) / INSTANTS * CLIP.last_s, 6)
    n = len(times)
    gaps = np.full(n, 0.02 * scale)
    moving = Points(scale * rng.normal(size=(n, 3)), rng.random(n).astype(np.float32), gaps, times)
    angles = np.linspace(0, math.pi, INSTANTS) / 2
    quats = np.stack([np.cos(angles), 0 * angles, 0 * angles, np.sin(angles)], axis=1)[None]
    centers = scale * np.stack([angles, 0 * angles, 0 * angles], axis=1)[None]
    bodies = Bodies(
        np.tile([0, 0, 0, 0, -1, -1], INSTANTS), quats, centers, times[::6], np.array([[0, 7]]), np.full(n, "")
    )
    if model == "bases":
        cloud = seed_rigid(Points.none(), moving, CLIP, INSTANTS, bodies)
    elif model in FIELDS:
        cloud = seed_field(Points.none(), moving, CLIP, 0, HexPlaneMotion if model == "4dgs" else DeformationMotion)
        generator = torch.Generator().manual_seed(1)
        last = cloud.motion.heads if model == "4dgs" else cloud.motion.exit
        last[:] = 0.1 * torch.randn(last.shape, generator=generator)
    elif model == "stg":
        cloud = seed_spacetime(Points.none(), moving, CLIP, INSTANTS)
        cloud.motion.turns[:] = 1
    elif model == "d3dgs":
        cloud = seed_timesteps(Points.none(), moving, CLIP)
        for done in (0.5, 0.8, 1.0):
            cloud.motion.advance(cloud.moving, done)
            cloud.moving.means += 0.01 * scale
    else:
        cloud = seed_cloud(Points.none(), moving, CLIP, INSTANTS, cubic=model == "cubic")
    for name, tensor in cloud.motion.tensors():
        if name in ("velocities", "accelerations", "jerks"):
            tensor[:] = scale
    return cloud


def finite_with_gradients(cloud: DynamicCloud, instant_s: float) -> None:
    """At the instant, everything is finite, and so is every gradient."""
    learnt = [t.requires_grad_() for name, t in cloud.tensors() if name.split(".")[1] not in cloud.motion.fixed]
    now = cloud.at(instant_s)
    assert all(torch.isfinite(t).all() for t in now)
    sum(t.sum() for t in now).backward()
    assert all(t.grad is None or torch.isfinite(t.grad).all() for t in learnt)


@pytest.mark.parametrize("scale", [1e-3, 2e3])
@pytest.mark.parametrize("model", MODELS)
def test_case_15_a_scene_of_another_scale_moves_the_same(model, scale):
    one, other = cloud_of(model), cloud_of(model, scale)
    for instant_s in (0.0, 0.007, 0.02):
        a, b = one.at(instant_s), other.at(instant_s)
        torch.testing.assert_close(b.means / scale, a.means, atol=1e-4, rtol=1e-4)
        torch.testing.assert_close(b.opacities, a.opacities)
        torch.testing.assert_close(b.quats_wxyz, a.quats_wxyz, atol=1e-4, rtol=1e-4)


@pytest.mark.parametrize("far", [2.0, 1e6, 1e20])
@pytest.mark.parametrize("model", FIELDS)
def test_case_16_points_outside_the_box_of_the_field_are_clamped(model, far):
    cloud = cloud_of(model)
    at_edge = cloud_of(model)
    low, high = cloud.motion.box
    half = (high - low) / 2
    cloud.moving.means[:] = (low + high) / 2 + far * half
    at_edge.moving.means[:] = high
    finite_with_gradients(cloud, 0.01)
    places = torch.full((1, 3), 1.0)
    torch.testing.assert_close(
        cloud.motion.offsets(((cloud.moving.means - low) / half - 1).clamp(-1, 1)[:1], 0.5)[0],
        cloud.motion.offsets(places, 0.5)[0],
    )
    shift = (cloud.at(0.01).log_scales - at_edge.at(0.01).log_scales).abs().max()
    assert float(shift.detach()) < 1e-3


@pytest.mark.parametrize("length", [1e-20, 1e20])
def test_case_17_a_body_turns_the_same_whatever_the_length_of_its_quaternions(length):
    cloud, other = cloud_of("bases"), cloud_of("bases")
    other.motion.knot_quats *= length
    torch.testing.assert_close(other.at(0.011).means, cloud.at(0.011).means)
    finite_with_gradients(other, 0.011)


@pytest.mark.parametrize("log_duration", [-100.0, 100.0])
@pytest.mark.parametrize("model", [m for m in MODELS if m not in LASTING])
def test_case_18_a_duration_of_nought_is_floored_and_one_without_end_is_always_there(model, log_duration):
    cloud = cloud_of(model)
    cloud.motion.log_durations[:] = log_duration
    cloud.motion.instants[:] = 0.5
    shown = cloud.at(0.02).opacities / cloud.moving.opacity_logits.sigmoid()
    assert torch.allclose(shown, torch.full_like(shown, float(log_duration > 0)), atol=1e-5)
    finite_with_gradients(cloud, 0.02)


@pytest.mark.parametrize("instant_s", [-1e6, -0.1, 0.5, 1e6])
@pytest.mark.parametrize("model", MODELS)
def test_case_19_far_outside_the_clip_everything_is_finite_and_free_movers_are_gone(model, instant_s):
    cloud = cloud_of(model)
    with torch.no_grad():
        now = cloud.at(instant_s)
    free = slice(len(cloud.motion.bodies), None) if model == "bases" else slice(None)
    if model not in LASTING:
        assert float(now.opacities[free].max()) < 1e-6
    if model in ("bases", *LASTING):
        bounded = now.means[: len(cloud.motion.bodies)] if model == "bases" else now.means
        assert float(bounded.abs().max()) < 20
    finite_with_gradients(cloud, instant_s)


def test_a_body_whose_quaternions_vanish_does_not_turn():
    cloud = cloud_of("bases")
    cloud.motion.knot_quats.zero_()
    finite_with_gradients(cloud, 0.01)
