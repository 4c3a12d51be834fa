"""Random rooms as they are described: what holds without a path tracer. That one draws them is in integration."""

from pathlib import Path

import numpy as np
import pytest

from acquisition.scenes.random.photographs import PHOTOGRAPHS
from acquisition.scenes.random.rooms import SPEED_M_S, WHITE, random_room
from acquisition.scenes.realistic import rooms
from acquisition.scenes.realistic.setting import KEYFRAME_S

SEEDS = range(40)
MIDDLE_S = 0.004


@pytest.fixture(scope="module")
def settings():
    return [random_room(np.random.default_rng(seed), MIDDLE_S) for seed in SEEDS]


def test_the_same_seed_is_the_same_room(settings):
    again = random_room(np.random.default_rng(3), MIDDLE_S)
    assert [thing.finish for thing in again.things] == [thing.finish for thing in settings[3].things]
    pairs = zip(again.things, settings[3].things, strict=True)
    assert all(np.array_equal(a.vertices(MIDDLE_S), b.vertices(MIDDLE_S)) for a, b in pairs)


def test_things_lie_inside_the_room_where_the_cameras_look(settings):
    for setting in settings:
        low, high = np.array(setting.corners)
        for thing in setting.things:
            middle = thing.vertices(MIDDLE_S).mean(axis=0)
            assert ((middle >= low - 1e-9) & (middle <= high + 1e-9)).all()
            if thing.body.startswith("thing"):
                assert middle[2] > 0.9


def test_rooms_are_unlike_one_another(settings):
    shares = {
        "moving": np.mean([bool(setting.movers) for setting in settings]),
        "plain": np.mean([not thing.finish.picture for setting in settings for thing in setting.things]),
        "coated": np.mean([thing.finish.gloss is not None for setting in settings for thing in setting.things]),
        "soft": np.mean([len(setting.lamps) == 1 for setting in settings]),
    }
    assert all(0.1 < share < 0.9 for share in shares.values()), shares
    assert len({thing.finish.picture for setting in settings for thing in setting.things}) > 5
    assert WHITE[1] < 1


def test_what_moves_is_as_fast_as_it_is_said_to_be(settings):
    speeds = []
    for setting in settings:
        for thing in setting.things:
            if thing.poses is not None:
                places = thing.poses[40:60, :, 3]  # some milliseconds about the trigger
                speeds.append(np.linalg.norm(np.diff(places, axis=0), axis=1).mean() / KEYFRAME_S)
    assert SPEED_M_S[0] * 0.9 < min(speeds) < 1.5
    assert 2.5 < max(speeds) < SPEED_M_S[1] + 0.5


@pytest.mark.parametrize("name", PHOTOGRAPHS)
def test_no_photograph_is_in_a_scene_that_anything_is_chosen_or_scored_on(name):
    package, file = name.split("/", 1)
    quoted = f'"{Path(file).stem}"' if package == "skimage" else name
    for source in Path(rooms.__file__).parent.glob("*.py"):
        text = source.read_text()
        assert name not in text
        assert quoted not in text
