"""Bodies in parts, and parts that are joined: motions that are known, ten seeds of noise, and cases without any."""

import math
from dataclasses import replace

import pytest
import torch

from reconstruction.gaussians import parts
from reconstruction.gaussians.cloud import GaussianCloud
from reconstruction.gaussians.dynamic import DynamicCloud
from reconstruction.gaussians.parts import joined, parted
from reconstruction.gaussians.rigid import RigidMotion
from reconstruction.quaternions import product, rotated, unit
from reconstruction.scene_model import TimeSpan

KNOTS, GAP_M = 9, 0.002
INSTANTS = [i / (KNOTS - 1) for i in range(KNOTS)]  # the knots
SEEDS = range(10)


def body(places: torch.Tensor, free: int = 7) -> DynamicCloud:
    """One body at rest with a rider at each of the places [A, 3], and free Gaussians."""
    n, one = len(places) + free, torch.tensor([1.0, 0, 0, 0])
    motion = RigidMotion(
        torch.zeros(len(places), dtype=torch.int64),
        one.expand(1, KNOTS, 4).clone(),
        torch.zeros(1, KNOTS, 3),
        torch.zeros(free, 3),
        torch.full((n,), 0.5),
        torch.zeros(n),
    )
    means = torch.cat([places, torch.ones(free, 3)])
    cloud = GaussianCloud.from_points(means, torch.full((n, 1), 0.3), torch.full((n,), -4.0), 0.6)
    none = GaussianCloud.from_points(torch.zeros(0, 3), torch.zeros(0, 1), torch.zeros(0), 0.6)
    return DynamicCloud(none, cloud, motion, TimeSpan(0.0, 0.02))


def bars(links: int, riders: int = 400) -> torch.Tensor:
    """Plain bars end to end along x, .2 m long and 5 cm thick, all in contact: riders [links * riders, 3]."""
    places = torch.rand(links, riders, 3, generator=torch.Generator().manual_seed(1)) - 0.5
    return (
        places * torch.tensor([0.2, 0.05, 0.05]) + 0.2 * torch.arange(links)[:, None, None] * torch.eye(3)[0]
    ).reshape(-1, 3)


def along_z(angle_rad: float) -> torch.Tensor:
    return torch.tensor([math.cos(angle_rad / 2), 0, 0, math.sin(angle_rad / 2)])


def learnt(cloud: DynamicCloud, turns_rad: list[float], seed: int) -> DynamicCloud:
    """The parts as they follow bars that turn at their joints by so much in the clip, each a little beside it."""
    generator, motion = torch.Generator().manual_seed(seed), cloud.motion
    noise = lambda n: 0.15 * torch.randn(n, generator=generator)  # noqa: E731
    quats, centers = motion.knot_quats.clone(), motion.knot_centers.clone()
    for k in range(len(quats)):
        link = round(float(centers[k, 0, 0]) / 0.2)
        for p, u in enumerate(INSTANTS):
            joint, turn = torch.tensor([-0.1, 0.0, 0.0]), torch.tensor([1.0, 0, 0, 0])
            for i in range(link + 1):
                turn = product(along_z(turns_rad[i] * u)[None], turn[None])[0]
                if i < link:
                    joint = joint + rotated(turn[None], torch.tensor([[0.2, 0.0, 0.0]]))[0]
            offset = motion.knot_centers[k, 0] - torch.tensor([0.2 * link - 0.1, 0.0, 0.0])
            centers[k, p] = joint + rotated(turn[None], offset[None])[0] + GAP_M * noise(3)
            shake = torch.cat([torch.ones(1), GAP_M / 0.06 * noise(3) / 2])
            quats[k, p] = product(turn[None], unit(shake)[None])[0]
    return replace(cloud, motion=replace(motion, knot_quats=quats, knot_centers=centers))


def places(cloud: DynamicCloud, u: float) -> torch.Tensor:
    return cloud.movers(cloud.clip.instant_s(u))[0]


def ridden(cloud: DynamicCloud, links: int) -> list[list[int]]:
    """The bodies that the riders of each bar are on."""
    return [own.unique().tolist() for own in cloud.motion.bodies.reshape(links, -1)]


def test_parts_are_small_and_begin_where_their_body_is():
    whole = learnt(body(bars(4)), [0.3], seed=0)
    cut = parted(whole)
    sizes = torch.bincount(cut.motion.bodies)
    assert 250 <= int(sizes.amin()) <= int(sizes.amax()) <= parts.RIDERS
    for u in INSTANTS:
        torch.testing.assert_close(places(cut, u), places(whole, u), atol=2e-6, rtol=0)
    torch.testing.assert_close(places(cut, 0.31), places(whole, 0.31), atol=2e-4, rtol=0)
    assert len(cut.motion.velocities) == 7


def test_as_many_as_they_may_be_they_get_larger(monkeypatch):
    monkeypatch.setattr(parts, "MOST_PARTS", 4)
    cut = parted(body(bars(5)))
    assert len(cut.motion.knot_quats) == 4
    assert torch.bincount(cut.motion.bodies).tolist() == [500] * 4


@pytest.mark.parametrize("riders", [0, 1, parts.RIDERS])
def test_a_body_of_few_is_not_cut(riders):
    cloud = body(torch.rand(riders, 3))
    assert parted(cloud) is cloud
    assert joined(cloud, math.inf) is cloud


@pytest.mark.parametrize("turns_rad", [[0.4, 0.0], [0.3, -0.5]], ids=["one body", "two bodies"])
def test_two_that_touch_all_the_time_are_as_many_as_they_are(turns_rad):
    """Two bars that met at every swept instant were taken for one; so were the halves of one bar, and rightly."""
    count = 1 + any(turns_rad[1:])
    for seed in SEEDS:
        cloud = learnt(parted(body(bars(2))), turns_rad, seed)
        found = joined(cloud, GAP_M)
        assert len(found.motion.knot_quats) == count
        assert sorted(ridden(found, 2)) == [[0], [count - 1]]
        for u in INSTANTS:
            aside = (places(found, u) - places(cloud, u))[: len(cloud.motion.bodies)].norm(dim=1)
            assert float(aside.square().mean().sqrt()) < GAP_M


def test_a_chain_of_plain_links_ends_as_its_links_whatever_the_seed():
    truth = [0.3, -0.4, 0.5, -0.3]
    for seed in SEEDS:
        found = joined(learnt(parted(body(bars(4))), truth, seed), GAP_M)
        assert len(found.motion.knot_quats) == 4
        assert sorted(ridden(found, 4)) == [[0], [1], [2], [3]]


def test_a_thing_that_bends_stays_in_parts_that_are_no_farther_aside_than_was_asked_for():
    sheet = body(bars(8))
    cloud = learnt(parted(sheet), [0.04] * 8, seed=0)
    found = joined(cloud, GAP_M)
    assert 2 <= len(found.motion.knot_quats) < len(cloud.motion.knot_quats)
    for u in INSTANTS:
        aside = (places(found, u) - places(cloud, u))[: len(cloud.motion.bodies)].norm(dim=1)
        assert float(aside.amax()) < 5 * GAP_M


def test_those_that_do_not_touch_stay_apart_however_alike():
    apart = bars(2) + torch.tensor([0.0, 2.0, 0.0]) * (torch.arange(800) >= 400)[:, None]
    found = joined(parted(body(apart)), math.inf)
    assert len(found.motion.knot_quats) == 2


def test_where_there_is_no_body_nothing_is_joined():
    cloud = body(bars(1)[:0])
    none = replace(cloud.motion, **{k: getattr(cloud.motion, k)[:0] for k in ("knot_quats", "knot_centers")})
    cloud = replace(cloud, motion=none)
    assert joined(cloud, GAP_M) is cloud


def test_a_part_that_nothing_rides_on_stays_and_harms_none():
    cloud = parted(body(bars(3)))
    knots = {name: getattr(cloud.motion, name) for name in ("knot_quats", "knot_centers")}
    spare = replace(cloud.motion, **{name: torch.cat([own, own[:1]]) for name, own in knots.items()})
    found = joined(replace(cloud, motion=spare), GAP_M)
    assert len(found.motion.knot_quats) == 2
    assert all(tensor.isfinite().all() for _, tensor in found.tensors())


@pytest.mark.parametrize("gap_m", [0.0, -1.0, math.nan])
def test_nothing_is_joined_within_no_gap(gap_m):
    cloud = learnt(parted(body(bars(2))), [0.3, 0.0], seed=1)
    assert joined(cloud, gap_m) is cloud


@pytest.mark.parametrize("flat", [[1, 1, 0], [1, 0, 0], [0, 0, 0]], ids=["a sheet", "a rod", "a point"])
def test_sheets_and_rods_keep_their_turn(flat):
    """Parts without thickness turn on as they did, though a fit to their places knows no turn."""
    whole = body(bars(4) * torch.tensor(flat, dtype=torch.float32))
    roll = torch.stack([torch.tensor([math.cos(u), math.sin(u), 0.0, 0.0]) for u in INSTANTS])
    turned = parted(replace(whole, motion=replace(whole.motion, knot_quats=roll[None])))
    assert len(turned.motion.knot_quats) == 4
    found = joined(turned, GAP_M)
    assert len(found.motion.knot_quats) == 1
    for u in INSTANTS:
        now, before = (c.motion.at(c.moving, u) for c in (found, turned))
        torch.testing.assert_close(now.means, before.means, atol=2e-6, rtol=0)
        same = (unit(now.quats_wxyz) * unit(before.quats_wxyz)).sum(dim=1).abs()
        assert float(same.amin()) > 1 - 1e-6


def test_it_is_the_same_in_double_precision():
    cloud = learnt(parted(body(bars(4))), [0.3, -0.4, 0.5, -0.3], seed=3)
    single, double = joined(cloud, GAP_M), joined(cloud.to(torch.float64), GAP_M)
    assert torch.equal(single.motion.bodies, double.motion.bodies)
    torch.testing.assert_close(places(single, 0.3).double(), places(double, 0.3), atol=1e-5, rtol=0)
