"""Lists the named scenes by their use: development, evaluation, stress, calibration, and the realistic ones.

Methods are chosen and tuned on DEVELOPMENT scenes with DEVELOPMENT_SEEDS. They are scored on EVALUATION scenes with
EVALUATION_SEEDS, which nothing is tuned on. BACKGROUNDS develop far, even, empty and plain ones. STRESS scenes have
one difficulty each; CALIBRATION ones calibrate a rig. REALISTIC ones, for development, and REALISTIC_EVALUATION ones
are drawn by a path tracer, an extra that is needed only where one is drawn. LONG_DEVELOPMENT and
LONG_EVALUATION scenes go on for any number of planes, REALISTIC_LONG and REALISTIC_LONG_EVALUATION ones for as long as
they are drawn.
Every other list of scene names, as of the command line and the benches, is made from these.
"""

import functools
from collections.abc import Callable

from acquisition.errors import BadRecordingError
from acquisition.scenes import calibration
from acquisition.scenes.carried_boxes import carried_boxes
from acquisition.scenes.collision import collision
from acquisition.scenes.demo import fan_and_ball
from acquisition.scenes.fan import fan
from acquisition.scenes.hoisted_barrels import hoisted_barrels
from acquisition.scenes.open_air import black, far, sky
from acquisition.scenes.plain import plain
from acquisition.scenes.pushed_blocks import pushed_blocks
from acquisition.scenes.realistic.rooms.banner import banner
from acquisition.scenes.realistic.rooms.chrome_table import chrome_table
from acquisition.scenes.realistic.rooms.courtyard import courtyard
from acquisition.scenes.realistic.rooms.dominoes import dominoes
from acquisition.scenes.realistic.rooms.loading_bay import loading_bay
from acquisition.scenes.realistic.rooms.marbles import marbles
from acquisition.scenes.realistic.rooms.plain_room import plain_room
from acquisition.scenes.realistic.rooms.robot_arm import robot_arm
from acquisition.scenes.realistic.rooms.sorting_hall import sorting_hall
from acquisition.scenes.realistic.rooms.thrown_things import thrown_things
from acquisition.scenes.realistic.scene import Build, DrawnScene
from acquisition.scenes.rolling_and_sliding import rolling_and_sliding
from acquisition.scenes.runner import runner
from acquisition.scenes.stress import bright, burst, deforming, dim, faint, flicker, outdoor, static, stiff
from acquisition.scenes.traffic import traffic
from acquisition.scenes.turntable import turntable
from acquisition.scenes.view import Scenery

DEVELOPMENT_SEEDS = (1, 2, 3)
EVALUATION_SEEDS = (101, 102, 103)
SCENES: dict[str, Callable[[int], Scenery]] = {}


def _listed(*builders: Callable[[int], Scenery]) -> tuple[str, ...]:
    names = {build.__name__: build for build in builders}
    SCENES.update(names)
    return tuple(names)


def _drawn(*builders: Build, moved_by: tuple[str, ...] = ()) -> tuple[str, ...]:
    names = {build.__name__: functools.partial(_scene_of, build, moved_by=moved_by) for build in builders}
    SCENES.update(names)
    return tuple(names)


def _scene_of(build: Build, seed: int, moved_by: tuple[str, ...]) -> Scenery:
    return DrawnScene(build.__name__, seed, build, moved_by=moved_by)


DEVELOPMENT = _listed(fan_and_ball)
EVALUATION = _listed(traffic, runner, turntable, collision, fan)
BACKGROUNDS = _listed(sky, far, black, plain)
STRESS = _listed(static, stiff, flicker, outdoor, dim, bright, burst, deforming, faint)
CALIBRATION = _listed(
    calibration.flat,
    calibration.dark,
    calibration.board_charuco,
    calibration.board_charuco_moving,
    calibration.board_april,
    calibration.board_april_moving,
)
LONG_DEVELOPMENT = _listed(carried_boxes, rolling_and_sliding)
LONG_EVALUATION = _listed(hoisted_barrels, pushed_blocks)
REALISTIC = _drawn(plain_room, thrown_things, robot_arm)
REALISTIC_EVALUATION = _drawn(chrome_table, dominoes, courtyard, banner, marbles)
_JOURNEYS = ("realistic/journeys", "passing", "routes")
REALISTIC_LONG = _drawn(sorting_hall, moved_by=_JOURNEYS)
REALISTIC_LONG_EVALUATION = _drawn(loading_bay, moved_by=_JOURNEYS)
PURPOSES = (
    ("What the cameras see. For development", DEVELOPMENT),
    ("for evaluation and nothing else", EVALUATION),
    ("for developing backgrounds", BACKGROUNDS),
    ("for stress", STRESS),
    ("for calibration", CALIBRATION),
    ("for any number of planes, as 4000 or 20000, for development", LONG_DEVELOPMENT),
    ("for evaluation and nothing else", LONG_EVALUATION),
    ("drawn by a path tracer, which takes minutes the first time, for development", REALISTIC),
    ("for evaluation and nothing else", REALISTIC_EVALUATION),
    ("drawn by it too, for up to 5000 planes and hours, for development", REALISTIC_LONG),
    ("for evaluation and nothing else", REALISTIC_LONG_EVALUATION),
)
GROUPS = {
    "realistic": REALISTIC,
    "realistic-evaluation": REALISTIC_EVALUATION,
    "long": LONG_DEVELOPMENT,
    "long-evaluation": LONG_EVALUATION,
    "realistic-long": REALISTIC_LONG,
    "realistic-long-evaluation": REALISTIC_LONG_EVALUATION,
}


def scenes_named(words: str) -> tuple[str, ...]:
    """Return the names in a list with commas between them, a group's name standing for all of it."""
    return tuple(name for word in words.split(",") for name in GROUPS.get(word, (word,)))


def build_scene(name: str, seed: int) -> Scenery:
    """Build the scene `name`, its textures and small placements drawn from `seed`.

    Raises BadRecordingError for an unknown name or a negative seed.
    """
    if name not in SCENES:
        raise BadRecordingError(f"found the scene {name!r}", f"one of {', '.join(SCENES)}")
    if seed < 0:
        raise BadRecordingError(f"found the seed {seed}", "a whole number from 0")
    return SCENES[name](seed)
