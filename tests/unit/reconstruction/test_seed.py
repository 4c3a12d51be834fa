"""Points to clouds: what rides on bodies is where its points were, and models without movers degrade."""

import numpy as np
import pytest
import torch

from reconstruction.gaussians.dynamic import DynamicCloud
from reconstruction.initialization.bodies import Bodies
from reconstruction.initialization.points import Points, Seeds
from reconstruction.initialization.seeding import seed_cloud, seed_field, seed_rigid, seed_spacetime, seed_timesteps
from reconstruction.scene_model import TimeSpan
from rigs.transform import Transform

CLIP = TimeSpan(0.0, 0.04)
INSTANTS = 4
TIMES_S = CLIP.last_s * (np.arange(INSTANTS) + 0.5) / INSTANTS


def points(count: int, instant_s: float = 0.0, seed: int = 0) -> Points:
    rng = np.random.default_rng(seed)
    light = rng.random(count).astype(np.float32)
    return Points(rng.normal(size=(count, 3)), light, np.full(count, 0.02), np.full(count, instant_s))


def seeds(moving: Points, seed: int = 0, bodies: Bodies | None = None) -> Seeds:
    return Seeds(points(3), moving, CLIP, INSTANTS, seed, (), lambda: bodies)


def poses() -> list[Transform]:
    turns = [Transform.from_quat_wxyz((np.cos(0.3 * i), 0, np.sin(0.3 * i), 0), (0, 0, 0)) for i in range(INSTANTS)]
    return [Transform(turn.rotation, np.array([0.1 * i, 0.2, 1.0])) for i, turn in enumerate(turns)]


def ridden(last: int = INSTANTS - 1) -> tuple[Points, Bodies]:
    """Six points at every instant, the first four on one body that is seen up to the instant `last`."""
    moving = Points.joined([points(6, s, seed=i) for i, s in enumerate(TIMES_S)])
    owners = np.tile([0, 0, 0, 0, -1, -1], INSTANTS)
    owners[6 * (last + 1) :] = -1
    quats, centers = np.stack([p.quat_wxyz for p in poses()]), np.stack([p.translation for p in poses()])
    return moving, Bodies(owners, quats[None], centers[None], TIMES_S, np.array([[0, last]]), np.full(len(owners), ""))


def test_at_each_instant_the_points_of_that_instant_are_where_they_were():
    moving, bodies = ridden()
    cloud = seed_rigid(seeds(moving, bodies=bodies))
    order = np.concatenate([np.flatnonzero(bodies.owners == 0), np.flatnonzero(bodies.owners < 0)])
    for instant_s in TIMES_S:
        now = cloud.at(float(instant_s)).means[3:]
        here = moving.instants_s[order] == instant_s
        np.testing.assert_allclose(now[here].numpy(), moving.positions[order][here], atol=1e-5)


def test_what_rides_lives_through_the_clip_and_the_free_for_a_while():
    moving, bodies = ridden()
    cloud = seed_rigid(seeds(moving, bodies=bodies))
    attached = len(cloud.motion.bodies)
    assert attached == 16
    for u in (0.0, 1.0):
        shown = cloud.at(u * CLIP.last_s).opacities[3:] / cloud.moving.opacity_logits.sigmoid()
        assert float(shown[:attached].min()) > 0.95
        assert float(shown[attached:].min()) < 0.1


def test_a_body_that_left_is_seen_no_more():
    moving, bodies = ridden(last=1)
    cloud = seed_rigid(seeds(moving, bodies=bodies))
    shown = cloud.at(CLIP.last_s).opacities[3 : 3 + len(cloud.motion.bodies)]
    assert float(shown.max()) < 0.1
    assert float(cloud.at(CLIP.last_s / 4).opacities[3 : 3 + len(cloud.motion.bodies)].min()) > 0.55


def test_the_spacing_on_a_body_is_that_of_all_instants_together():
    moving, bodies = ridden()
    cloud = seed_rigid(seeds(moving, bodies=bodies))
    assert float(cloud.moving.log_scales[:16].std()) > 0  # measured anew in the body's frame
    assert torch.allclose(cloud.moving.log_scales[16:].exp(), torch.tensor(0.01))


@pytest.mark.parametrize("owned", [True, False])
def test_bodies_without_points_and_points_without_bodies_are_clouds(owned):
    none = Bodies(
        np.full(6, -1), np.zeros((0, 4, 4)), np.zeros((0, 4, 3)), TIMES_S, np.zeros((0, 2), int), np.full(6, "")
    )
    empty = Bodies(none.owners[:0], none.quats_wxyz, none.centers, TIMES_S, none.seen, none.reasons[:0])
    moving = points(6, 0.02) if owned else Points.none()
    cloud = seed_rigid(seeds(moving, bodies=none if owned else empty))
    linear = seed_cloud(seeds(moving))
    for mine, theirs in zip(cloud.at(0.013), linear.at(0.013), strict=True):
        assert torch.allclose(mine, theirs, atol=1e-6)


def test_a_field_is_drawn_from_its_seed_and_left_out_without_movers():
    first, again, other = (seed_field(seeds(points(5), seed)) for seed in (1, 1, 2))
    assert all(torch.equal(a, b) for (_, a), (_, b) in zip(first.tensors(), again.tensors(), strict=True))
    assert not torch.equal(first.motion.coarse_space, other.motion.coarse_space)
    still = seed_field(seeds(Points.none()))
    assert still.motion.kind == "polynomial"
    assert len(still.at(0.01).means) == 3


def test_every_model_comes_back_from_its_state(tmp_path):
    moving, bodies = ridden()
    for cloud in (
        seed_cloud(seeds(moving), cubic=True),
        seed_rigid(seeds(moving, bodies=bodies)),
        seed_field(seeds(moving)),
        seed_field(seeds(moving), "4dgs-small"),
        seed_spacetime(seeds(moving)),
        seed_timesteps(seeds(moving)),
    ):
        torch.save(cloud.state(), tmp_path / "state.pt")
        back = DynamicCloud.from_state(torch.load(tmp_path / "state.pt", weights_only=True))
        assert type(back.motion) is type(cloud.motion)
        for a, b in zip(cloud.at(0.013), back.at(0.013), strict=True):
            assert torch.equal(a, b)
