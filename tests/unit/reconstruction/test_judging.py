"""Which bodies explain counts that they were not made from."""

from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from reconstruction.gaussians.cloud import GaussianCloud
from reconstruction.gaussians.dynamic import DynamicCloud
from reconstruction.gaussians.polynomial import PolynomialMotion
from reconstruction.images.flicker import Light
from reconstruction.initialization.bodies import UNLIKE, Bodies
from reconstruction.initialization.judging import LEAST_SPIKES, WIDEST_PX, between, judge, square_px
from reconstruction.initialization.points import Points, Seeds
from reconstruction.initialization.seeding import seed_cloud, seed_rigid
from reconstruction.pipeline import points_stage
from reconstruction.pipeline.points_stage import moving_points
from tests.unit.reconstruction.test_supervision import CAMERA, CLIP, CLOCK, cloud, seen

PLANES = (8, 24, 40, 56)  # at which movers are swept
SPEED = 0.8  # metres a clip


@pytest.fixture(scope="module")
def truth() -> DynamicCloud:
    """A wall, and before it a board of bright and dark points that crosses SPEED metres a clip."""
    rng = np.random.default_rng(3)
    across, down = np.meshgrid(np.linspace(-0.25, 0.25, 12), np.linspace(-0.2, 0.2, 10))
    places = np.column_stack([across.ravel() - SPEED / 2, down.ravel(), np.full(across.size, 1.5)])
    light = torch.tensor(rng.uniform(0.05, 0.9, (len(places), 1)), dtype=torch.float32)
    sizes = torch.full((len(places),), 0.022).log()
    board = GaussianCloud.from_points(torch.tensor(places, dtype=torch.float32), light, sizes, 0.95)
    motion = PolynomialMotion.at_rest(torch.zeros(len(places)), 100.0)
    motion.velocities[:] = torch.tensor([SPEED, 0.0, 0.0])
    return DynamicCloud(cloud().still, board, motion, CLIP)


@pytest.fixture(scope="module")
def view(truth):
    return seen(truth)


def seeds(truth: DynamicCloud, speed: float) -> Seeds:
    """The points of the board at the swept instants, on a body that is thought to cross `speed` metres a clip."""
    instants_s = [CLOCK.instant_s(plane) for plane in PLANES]
    starts, light = truth.moving.means.numpy().astype(np.float64), truth.moving.intensities[:, 0].numpy()
    swept = []
    for at_s in instants_s:
        places = starts + np.array([SPEED * CLIP.fraction(at_s), 0, 0])
        swept.append(Points(places, light, np.full(len(places), 0.045), np.full(len(places), at_s)))
    moving, instants = Points.joined(swept), len(PLANES)
    centers = np.array([[[speed * CLIP.fraction(at_s), 0, 0] for at_s in instants_s]])
    upright = np.tile([1.0, 0.0, 0.0, 0.0], (1, instants, 1))
    owners, nowhere = np.zeros(len(moving), np.int64), np.full(len(moving), "", dtype=f"<U{len(UNLIKE)}")
    bodies = Bodies(owners, upright, centers, np.array(instants_s), np.array([[0, instants - 1]]), nowhere)
    return Seeds(Points.none(), moving, CLIP, instants, 0, [CAMERA], lambda: bodies)


@pytest.mark.parametrize(("speed", "kept"), [(SPEED, [0]), (-SPEED, []), (0.0, []), (3 * SPEED, [])])
def test_a_body_is_kept_where_it_moves_as_the_counts_say(truth, view, speed, kept):
    own = seeds(truth, speed)
    found = judge(own, [(view.camera, view.source)], CLOCK, truth.still)
    assert found.kept.tolist() == kept
    assert found.resting[0] > 0
    left = own.bodies().only(found.kept)
    assert len(left) == len(kept)
    assert left.free == ({} if kept else {UNLIKE: len(own.moving)})


def test_the_errors_are_those_of_a_plain_sum_over_pixels(truth, view):
    own, sums, cloud_of = seeds(truth, SPEED), np.zeros(2), {"riding": seed_rigid, "resting": seed_cloud}
    found = judge(own, [(view.camera, view.source)], CLOCK, truth.still)
    for before, after in pairwise(own.bodies().instants_s):
        first = round((before + after) / 2 * CLOCK.tick_rate_hz - 0.5) - 4
        at_s = CLOCK.instant_s(first + 4)
        counts = view.source.counts(first, first + 9).astype(np.float64)
        clouds = {name: replace(start(own), still=truth.still) for name, start in cloud_of.items()}
        near = own.moving.positions[np.isin(own.moving.instants_s, [before, after])]
        places = np.concatenate([clouds["riding"].movers(at_s)[0].double().numpy(), near])
        pixels = {
            (int(row) + i, int(column) + j)
            for (column, row), inside in zip(*CAMERA.project(places), strict=True)
            for i in (-1, 0, 1)
            for j in (-1, 0, 1)
            if inside
        }
        for number, name in enumerate(cloud_of):
            light = clouds[name].look(CAMERA, at_s).intensity.astype(np.float64)
            own_px = [p for p in pixels if 0 <= p[0] < CAMERA.height and 0 <= p[1] < CAMERA.width]
            sums[number] += sum(abs(counts[p] - 9 * light[p]) for p in own_px if view.source.moving[p])
    assert [found.riding[0], found.resting[0]] == pytest.approx(sums, rel=1e-5)
    assert found.ratio == pytest.approx(sums[0] / sums[1], rel=1e-5)


def test_one_of_two_bodies_is_kept_and_numbered_anew(truth, view):
    right, wrong = seeds(truth, SPEED).bodies(), seeds(truth, -SPEED).bodies()
    upper = seeds(truth, SPEED).moving.positions[:, 1] > 0
    both = replace(
        right,
        owners=np.where(upper, 0, 1),
        quats_wxyz=np.concatenate([wrong.quats_wxyz, right.quats_wxyz]),
        centers=np.concatenate([wrong.centers, right.centers]),
        seen=np.concatenate([wrong.seen, right.seen]),
    )
    own = replace(seeds(truth, SPEED), bodies=lambda: both)
    found = judge(own, [(view.camera, view.source)], CLOCK, truth.still)
    left = both.only(found.kept)
    assert found.kept.tolist() == [1]
    assert left.owners.tolist() == np.where(upper, -1, 0).tolist()
    assert np.array_equal(left.centers, right.centers)


def test_nothing_in_doubt_without_bodies_or_views_that_see_movers(truth, view):
    own = seeds(truth, -SPEED)
    none = replace(own, bodies=lambda: own.bodies().only(np.zeros(0, np.int64)))
    assert judge(none, [(view.camera, view.source)], CLOCK).kept.tolist() == []
    assert judge(none, [(view.camera, view.source)], CLOCK).ratio == 1.0
    still = replace(view.source, moving=np.zeros_like(view.source.moving))
    for views in ([], [(view.camera, still)]):
        assert judge(own, views, CLOCK).kept.tolist() == [0]


def test_windows_are_cut_at_the_ends_of_a_short_recording(truth, view):
    short = view.source.part(0, 20)
    found = judge(seeds(truth, SPEED), [(view.camera, short)], CLOCK, truth.still)
    assert np.isfinite(found.riding).all()
    assert np.isfinite(found.resting).all()


def test_instants_between_neighbours():
    assert between([0.5, 1.5, 3.5]) == [1.0, 2.5]
    assert between([7.0]) == []


@pytest.mark.parametrize(("spikes", "side"), [(9.0, 1), (1.0, 1), (0.9, 3), (LEAST_SPIKES / 25, 5), (0.0, WIDEST_PX)])
def test_pixels_that_seldom_fire_are_judged_in_squares(spikes, side):
    assert square_px(spikes) == side


def test_flickering_light_changes_no_verdict(truth, view):
    gains = np.where(np.arange(len(view.source.stream)) % 24 < 12, 0.4, 1.6).astype(np.float32)
    lit = replace(truth, light=torch.from_numpy(gains))
    flickering = replace(seen(lit).source, light=Light(gains), moving=view.source.moving)
    steady, found = (
        judge(seeds(truth, SPEED), [(view.camera, source)], CLOCK, truth.still) for source in (view.source, flickering)
    )
    assert found.kept.tolist() == [0]
    assert found.ratio == pytest.approx(steady.ratio, abs=0.1)
    assert steady.ratio < 0.9


def test_points_of_movers_have_the_light_that_they_would_have_without_flicker(view, monkeypatch):
    gains = np.where(np.arange(len(view.source.stream)) % 2, 0.5, 1.5).astype(np.float32)
    swept = []
    monkeypatch.setattr(points_stage, "swept_maps", lambda cameras, images, *_: swept.extend(images))
    monkeypatch.setattr(points_stage, "sample_points", lambda *_: None)
    source = SimpleNamespace(light=Light(gains), white=0.9, movers=lambda *_: view.source.moving)
    source.at = lambda plane: np.full((CAMERA.height, CAMERA.width), 0.3 * gains[plane], np.float32)
    for plane in (8, 9):
        moving_points({"cam00": source}, [CAMERA], (plane, 0.0), 10, np.random.default_rng(0))
    assert [image.mean() for image in swept] == pytest.approx([0.3, 0.3], rel=1e-6)
