"""The long scenes keep what they promise, measured on their truth: how much moves, when nothing does, what goes on."""

from dataclasses import replace

import numpy as np
import pytest
from maintenance.scene_digests import LONG_INSTANTS_S, long_evaluation_digests, scene_digest

from acquisition.scenes.bodies import about, at
from acquisition.scenes.catalog import (
    DEVELOPMENT_SEEDS,
    EVALUATION_SEEDS,
    LONG_DEVELOPMENT,
    LONG_EVALUATION,
    build_scene,
    scenes_named,
)
from acquisition.scenes.digest import COMMITTED_LONG, committed_digests
from acquisition.scenes.motion import Motion
from acquisition.scenes.routes import Journeys, Paused, Route
from acquisition.scenes.source import SceneSource
from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.sensor import Sensor
from rigs.camera import Camera
from rigs.clock import RigClock
from rigs.toml import catalog_rig
from rigs.transform import Transform

RATE_HZ, SPAN, SPANS = 20000.0, 400, 50  # a second
SMALL = Camera("cam11", 400, 250, 350.0, 350.0, 200.0, 125.0, Transform.identity()).scaled(64, 40)
STEP_S = 1 / RATE_HZ
EVERY = 50  # planes
CARRIED = ("crane", "arm", "hoist", "pusher", "box")  # these, and what carries them; all others pass


class Watched:
    """Holds where things are seen, and which of them move, at every 50th plane of a second."""

    def __init__(self, name: str, seed: int):
        self.scene = scene = build_scene(name, seed)
        instants_s = (np.arange(0, SPANS * SPAN, EVERY) + 0.5) / RATE_HZ
        self.ids = scene.view(SMALL, 1).frames(instants_s).ids  # [n, H, W]
        before, after = scene.placements(instants_s), scene.placements(instants_s + STEP_S)
        moves = (before.rotations != after.rotations).any(axis=(2, 3)) | (before.positions != after.positions).any(
            axis=2
        )
        shapes = scene.arrays.ids
        self.moves = {number: moves[:, shapes == number].any(axis=1) for number in scene.object_ids.values()}
        self.pixels = {number: (self.ids == number).sum(axis=(1, 2)) for number in scene.object_ids.values()}
        moved = sum(self.pixels[number] * self.moves[number] for number in self.moves)
        self.shares = (moved / self.ids[0].size).reshape(SPANS, -1).mean(axis=1)
        self.still = ~np.any(list(self.moves.values()), axis=0).reshape(SPANS, -1).any(axis=1)

    def named(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Return how many pixels a body has and whether it moves [n]."""
        number = self.scene.object_ids[name]
        return self.pixels[number], self.moves[number]


@pytest.fixture(
    scope="module", params=[(name, seed) for name in LONG_DEVELOPMENT for seed in DEVELOPMENT_SEEDS], ids=str
)
def watched(request):
    return Watched(*request.param)


def passers(watched: Watched) -> list[str]:
    return [name for name in watched.scene.movers if not name.startswith(CARRIED)]


@pytest.mark.parametrize("spans", [10, SPANS])  # 4,000 and 20,000 planes
def test_a_tenth_of_the_view_moves_in_four_spans_of_five_and_some_spans_are_still(watched, spans):
    assert (watched.shares[:spans] >= 0.1).mean() >= 0.8
    assert 0 < watched.still[:spans].mean() <= 0.2


def test_a_still_stretch_shows_the_same_light_to_the_bit(watched):
    span = int(np.nonzero(watched.still)[0][0])
    instants_s = (np.arange(span * SPAN, (span + 1) * SPAN, 20) + 0.5) / RATE_HZ
    light = watched.scene.view(SMALL, 1).light(instants_s)
    assert (light == light[0]).all()


def test_things_enter_stop_in_view_and_leave(watched):
    entered = left = stopped = 0
    for name in passers(watched):
        pixels, moves = watched.named(name)
        entered += (np.diff((pixels > 0).astype(int)) == 1).sum()
        left += (np.diff((pixels > 0).astype(int)) == -1).sum()
        others = np.any([watched.named(other)[1] for other in passers(watched) if other != name], axis=0)
        stopped += ((pixels > 20) & ~moves & others).any()
    assert entered >= 10
    assert left >= 10
    assert stopped >= 3


def test_things_turn_back_in_view(watched):
    scene, numbers = watched.scene, watched.scene.object_ids
    instants_s = (np.arange(0, SPANS * SPAN, EVERY) + 0.5) / RATE_HZ
    positions = scene.placements(instants_s).positions[..., 0]
    turned = 0
    for name in passers(watched):
        x = positions[:, scene.arrays.ids == numbers[name]][:, 0]
        seen = watched.pixels[numbers[name]] > 0
        ways = np.sign(np.diff(x)) * (seen[1:] & seen[:-1])
        ways = ways[ways != 0]
        turned += (np.diff(ways) != 0).sum()
    assert turned >= 3


def test_the_first_box_is_carried_and_then_stays_for_good(watched):
    _, moves = watched.named("box0")
    put_down = int(np.nonzero(moves)[0][-1]) + 1
    assert 3 < put_down * EVERY / SPAN < 8  # spans; it has moved in view, and stands for the rest
    instants_s = np.array([put_down * EVERY * STEP_S, 1.0, 7.7, 3600.0])
    shape = watched.scene.arrays.ids == watched.scene.object_ids["box0"]
    places = watched.scene.placements(instants_s).positions[:, shape]
    assert (places == places[0]).all()
    pixels, _ = watched.named("box0")
    assert (pixels[moves] > 0).any()
    assert (pixels[put_down:] > 0).mean() > 0.3
    assert sum(watched.named(f"box{i}")[1].any() for i in range(3)) >= 3


def test_things_hide_one_another(watched):
    instants_s = (np.arange(0, SPANS * SPAN, EVERY) + 0.5) / RATE_HZ
    hidden = 0
    for name in passers(watched):
        number = watched.scene.object_ids[name]
        alone = replace(watched.scene, bodies=(watched.scene.bodies[number - 1],))
        covered = alone.view(SMALL, 1).frames(instants_s).ids == 1
        other = np.isin(watched.ids, [other for other in watched.scene.movers.values() if other != number])
        hidden += (covered & other).sum(axis=(1, 2)).max() > 20
    assert hidden >= 3


def test_nothing_is_faster_than_three_pixels_in_nine_planes(watched):
    instants_s = (np.arange(0, SPANS * SPAN, EVERY) + 0.5) / RATE_HZ
    before, after = (watched.scene.placements(t).positions for t in (instants_s, instants_s + 9 * STEP_S))
    ways_m = np.linalg.norm(after - before, axis=-1)
    visible = (np.abs(before[..., 0]) < 0.7 * before[..., 2]) & (np.abs(after[..., 0]) < 0.7 * after[..., 2])
    assert (350 * ways_m / before[..., 2])[visible].max() < 3
    assert (350 * ways_m / before[..., 2])[visible].max() > 0.5


def test_what_waits_for_its_journey_changes_nothing_in_any_view(watched):
    scene = watched.scene
    still = tuple(body for body in scene.bodies if not body.moving)
    cameras = catalog_rig("lab3x3").scaled(64, 40).cameras
    empty = [replace(scene, bodies=still).view(camera, 1).light(np.zeros(1)) for camera in cameras]
    for body in scene.bodies:
        if body in still or body.name.startswith("box"):
            continue
        first, *_, last = body.motions[0].movement.route_of(3).stops
        for stop in (first, last):
            waiting = replace(body, motion=Motion(at(*stop.place_m, about(1, stop.turn_rad))))
            beside = replace(scene, bodies=(*still, waiting))
            for camera, light in zip(cameras, empty, strict=True):
                np.testing.assert_array_equal(beside.view(camera, 1).light(np.zeros(1)), light, err_msg=body.name)


@pytest.mark.parametrize("name", LONG_DEVELOPMENT)
def test_any_part_of_a_recording_is_that_part_of_a_longer_one(name):
    scene, first = build_scene(name, 2), 1780
    later = scene.since(first / RATE_HZ)
    at = np.arange(first, first + SPAN, 16)
    whole, part = scene.view(SMALL, 1), later.view(SMALL, 1)
    expected = whole.light((at + 0.5) / RATE_HZ)
    np.testing.assert_allclose(part.light((at - first + 0.5) / RATE_HZ), expected, atol=1e-5)
    assert (whole.frames((at + 0.5) / RATE_HZ).ids == part.frames((at - first + 0.5) / RATE_HZ).ids).mean() > 0.9999


def test_planes_of_a_part_are_those_of_the_whole_but_for_the_charge_they_begin_with():
    light = []

    class Film(Sensor):
        def expose(self, intensity):
            light[-1].append(intensity)
            return super().expose(intensity)

    for begins, ticks in ((0, 120), (70, 50)):
        light.append([])
        scene = build_scene("carried_boxes", 1).since(begins / RATE_HZ)
        film = Film(SMALL.width, SMALL.height, "ideal", 0, 0)
        source = SceneSource(scene, SMALL, RigClock(RATE_HZ), ticks, film, PlaneLayout(SMALL.width, SMALL.height))
        source.next_planes(ticks)
    whole, part = (np.concatenate(chunks) for chunks in light)
    np.testing.assert_allclose(part, whole[70:], atol=1e-5)


def test_seeds_differ_and_the_group_is_named():
    first, second = (build_scene("carried_boxes", seed).placements(np.array([0.01])) for seed in (1, 2))
    assert (first.positions != second.positions).any()
    assert scenes_named("long") == LONG_DEVELOPMENT
    assert scenes_named("long-evaluation") == LONG_EVALUATION


def area_of(scene) -> float:
    """Return the area of the passers at their depths, as a share of the centre view."""
    area = 0.0
    for body in scene.bodies:
        if body.moving and not body.name.startswith(CARRIED):
            depth_m = body.motions[0].movement.route_of(0).stops[0].place_m[2]
            for shape in body.shapes:
                square_m = (
                    np.pi * shape.size[0] ** 2 if shape.kind in ("sphere", "cylinder") else 4 * np.prod(shape.size[:2])
                )
                area += square_m * (350 / depth_m) ** 2 / (400 * 250)
    return area


def test_the_evaluation_scenes_are_built_of_the_same_parts_and_as_large_ones():
    """Nothing of them is drawn: that a tenth of the view moves rests on the sizes of what passes."""
    least = min(area_of(build_scene(name, 1)) for name in LONG_DEVELOPMENT)
    for name in LONG_EVALUATION:
        scene = build_scene(name, EVALUATION_SEEDS[0])
        assert area_of(scene) > least
        moving = [body for body in scene.bodies if body.moving]
        assert {type(motion) for body in moving for motion in body.motions} == {Paused}
        assert {type(body.motions[0].movement) for body in moving} == {Journeys, Route}
        assert sum(body.name.startswith("box") for body in moving) >= 3


def test_one_long_evaluation_scene_is_the_committed_one():
    name = LONG_EVALUATION[0]
    found = scene_digest(build_scene(name, 101), LONG_INSTANTS_S)
    assert found == committed_digests(COMMITTED_LONG)[f"{name}-101"]


@pytest.mark.slow
def test_the_long_evaluation_scenes_are_the_committed_ones():
    assert long_evaluation_digests() == committed_digests(COMMITTED_LONG)
    assert len(set(committed_digests(COMMITTED_LONG).values())) == len(LONG_EVALUATION) * len(EVALUATION_SEEDS)
