"""Bodies keep their number through spans that each found them anew, in another order and in frames of their own."""

import csv
import math
from itertools import pairwise

import numpy as np
import pytest
import torch

from reconstruction.errors import BadRunError
from reconstruction.evaluation.identities import Identities, identities
from reconstruction.export.catalogue import export_scene
from reconstruction.export.scene import Choices, Scene
from reconstruction.gaussians.cloud import GaussianCloud
from reconstruction.gaussians.dynamic import DynamicCloud
from reconstruction.gaussians.rigid import RigidMotion
from reconstruction.gaussians.spanned import SpanContent, SpannedScene, nothing
from reconstruction.gaussians.tracks import LEAST_RIDERS, same_bodies, tracks_of
from reconstruction.quaternions import matrices
from reconstruction.scene_model import TimeSpan
from reconstruction.truth import TruthFrame
from rigs.camera import Camera
from rigs.clock import RigClock
from rigs.rig import Rig
from rigs.transform import Transform

DISTANCE_M, RATE_HZ, SPAN_S, OVERLAP_S = 2.0, 20_000.0, 0.02, 0.0012
SPANS, KNOTS, RIDERS = 3, 17, 200
SPIN = 20.0  # rad/s about z
STARTS = ((-0.4, 0.0, 2.0), (0.3, 0.1, 2.0))  # m, of two bodies
VELOCITIES = ((3.0, 0.0, 0.0), (-2.0, 1.0, 0.0))  # m/s


def turned(angle):
    return torch.tensor([math.cos(angle / 2), 0.0, 0.0, math.sin(angle / 2)])


def span_of(number, order, riders=RIDERS):
    """A span that has found the bodies `order` in this order, with frames and Gaussians of its own."""
    own = TimeSpan(number * SPAN_S, (number + 1) * SPAN_S)
    clip = TimeSpan(own.first_s - OVERLAP_S, own.last_s + OVERLAP_S)
    generator = torch.Generator().manual_seed(number)
    means, bodies, quats, centers = [], [], [], []
    for place, body in enumerate(order):
        offset = 0.02 * torch.randn(3, generator=generator)  # of the span's frame from the body's middle
        first = 0.7 * number + 0.2 * body  # by which it is turned
        box = (torch.rand(riders, 3, generator=generator) - 0.5) * torch.tensor([0.2, 0.12, 0.1])
        means.append((box - offset) @ matrices(turned(first)[None])[0])
        bodies += [place] * riders
        instants = torch.linspace(clip.first_s, clip.last_s, KNOTS)
        turns = torch.stack([turned(SPIN * t + first) for t in instants.tolist()])
        middles = torch.tensor(STARTS[body]) + instants[:, None] * torch.tensor(VELOCITIES[body])
        spun = matrices(torch.stack([turned(SPIN * t) for t in instants.tolist()]))
        centers.append(middles + spun @ offset)
        quats.append(turns)
    count = len(bodies)
    turns = torch.tensor([[1.0, 0, 0, 0]]).repeat(count, 1)
    every = torch.cat(means) if means else torch.zeros(0, 3)
    cloud = GaussianCloud(every, turns, torch.full((count, 3), -4.0), torch.full((count,), 3.0), torch.ones(count, 1))
    knots = (
        (torch.stack(quats), torch.stack(centers)) if order else (torch.zeros(0, KNOTS, 4), torch.zeros(0, KNOTS, 3))
    )
    windows = torch.full((count,), 0.5), torch.full((count,), 6.0)
    motion = RigidMotion(torch.tensor(bodies, dtype=torch.int64), *knots, torch.zeros(0, 3), *windows)
    still = torch.zeros(0, dtype=torch.int64), torch.zeros(0), torch.zeros(0, 1)
    return SpanContent(own, *still, cloud=DynamicCloud(nothing(), cloud, motion, clip))


def scene_of(*orders):
    spans = [span_of(number, order) for number, order in enumerate(orders)]
    return SpannedScene(nothing(), spans, TimeSpan(0.0, SPAN_S * len(spans)))


def test_bodies_are_followed_in_whatever_order_they_are_found():
    tracks = tracks_of(scene_of((0, 1), (1, 0), (0, 1)), DISTANCE_M)
    assert [[leg.body for leg in track.legs] for track in tracks] == [[0, 1, 0], [1, 0, 1]]


def test_a_track_goes_on_at_a_seam_without_a_step_and_moves_as_the_body_does():
    for body, track in enumerate(tracks_of(scene_of((0, 1), (1, 0), (0, 1)), DISTANCE_M)):
        instants = np.linspace(0.0, SPANS * SPAN_S, 200, endpoint=False)
        poses = [track.at(t).pose(t) for t in instants.tolist()]
        places = torch.cat([place for _, place in poses]).double().numpy()
        gaps = places - np.array(STARTS[body]) - instants[:, None] * np.array(VELOCITIES[body])
        assert np.abs(gaps - gaps.mean(axis=0)).max() < 4e-3  # the middle is not what it turns about
        assert np.abs(gaps).max() < 0.03  # it stands in the middle of its Gaussians
        cosines = [abs(float((a * b).sum())) for (a, _), (b, _) in pairwise(poses)]
        turns = 2 * np.arccos(np.minimum(1.0, cosines))
        assert np.allclose(turns, SPIN * (instants[1] - instants[0]), atol=4e-3)
        assert track.at(SPANS * SPAN_S) is None


def test_a_body_that_is_not_found_ends_and_one_that_is_new_begins():
    tracks = tracks_of(scene_of((0, 1), (0,), (0, 1)), DISTANCE_M)
    assert [[leg.number for leg in track.legs] for track in tracks] == [[0, 1, 2], [0], [2]]
    assert tracks_of(scene_of((), (), ()), DISTANCE_M) == []
    rest = scene_of((0,), (0,))
    rest.spans[1] = SpanContent.as_usual(rest.spans[1].clip)
    assert [len(track.legs) for track in tracks_of(rest, DISTANCE_M)] == [1]


def test_bodies_elsewhere_or_of_next_to_nothing_are_not_the_same():
    before, after = (span_of(number, (0,)).cloud for number in (0, 1))
    assert same_bodies(before, after, SPAN_S, 0.02) == {0: 0}
    assert same_bodies(before, span_of(1, (1,)).cloud, SPAN_S, 0.02) == {}
    assert same_bodies(before, span_of(1, (0,), LEAST_RIDERS - 1).cloud, SPAN_S, 0.02) == {}
    assert same_bodies(None, after, SPAN_S, 0.02) == {}


def test_a_scene_in_one_piece_has_a_track_a_body():
    cloud = span_of(0, (0, 1)).cloud
    assert [len(track.legs) for track in tracks_of(cloud, DISTANCE_M)] == [1, 1]


@pytest.fixture
def rig():
    poses = [Transform.looking_at((x, 0.0, 0.0), (0.0, 0.0, 2.0)) for x in (0.0, 0.2)]
    return Rig(
        "pair", RATE_HZ, tuple(Camera(f"cam0{i}", 80, 60, 60.0, 60.0, 40.0, 30.0, p) for i, p in enumerate(poses))
    )


def test_the_table_has_every_body_at_every_instant(rig, tmp_path):
    scene = Scene(scene_of((0, 1), (1,)), rig, 1.0, "bases", None, dict)
    export_scene(scene, "tracks", tmp_path / "tracks.csv", Choices(frames=10))
    rows = list(csv.DictReader((tmp_path / "tracks.csv").read_text().splitlines()))
    assert list(rows[0]) == ["track", "instant_s", "x_m", "y_m", "z_m", "qw", "qx", "qy", "qz"]
    assert [sum(row["track"] == track for row in rows) for track in ("0", "1")] == [5, 10]
    last = rows[-1]
    expected = np.array(STARTS[1]) + float(last["instant_s"]) * np.array(VELOCITIES[1])
    assert np.allclose([float(last[axis]) for axis in ("x_m", "y_m", "z_m")], expected, atol=0.03)
    assert sum(float(last[part]) ** 2 for part in ("qw", "qx", "qy", "qz")) == pytest.approx(1, abs=1e-5)


def test_a_model_without_bodies_has_no_table(scene_with, tmp_path):
    with pytest.raises(BadRunError, match="one with rigid bodies"):
        export_scene(scene_with("cubic"), "tracks", tmp_path / "tracks.csv", Choices())
    export_scene(scene_with("bases"), "tracks", tmp_path / "tracks.csv", Choices(frames=3))


class KnownObjects:
    """Truth of one camera, in which the left of the picture shows object 7 and the right object 8, or all `one`."""

    lag_ticks = 0.0

    def __init__(self, switches_at=None):
        self.switches_at = switches_at

    def planes(self, camera_id):
        return list(range(0, int(2 * SPAN_S * RATE_HZ), 20))

    def frame(self, camera_id, plane):
        ids = np.full((60, 80), 7)
        if self.switches_at is not None and plane >= self.switches_at:
            ids[:] = 9
        return TruthFrame(plane, np.zeros((60, 80)), np.full((60, 80), 2.0, np.float32), ids > 0, ids)


@pytest.mark.parametrize(("switches_at", "switched"), [(None, 0), (400, 2), (600, 0)])
def test_a_switch_is_counted_where_the_object_behind_a_body_changes_at_a_seam(rig, switches_at, switched):
    scene = scene_of((0, 1), (1, 0))
    tracks = tracks_of(scene, DISTANCE_M)
    found = identities(tracks, scene, rig.cameras[0], KnownObjects(switches_at), RigClock(RATE_HZ))
    assert found == Identities(2, switched)
