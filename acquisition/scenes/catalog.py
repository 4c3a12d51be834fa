"""The named scenes, in closed lists: which are for development, which for evaluation, which for what else.

Methods are chosen and tuned on DEVELOPMENT scenes with DEVELOPMENT_SEEDS, and scored on EVALUATION scenes with
EVALUATION_SEEDS, which nothing is tuned on. STRESS scenes have one difficulty each; CALIBRATION ones calibrate a rig.
"""

from collections.abc import Callable

from acquisition.errors import BadRecordingError
from acquisition.scenes import calibration, stress
from acquisition.scenes.demo import fan_and_ball
from acquisition.scenes.fans import fan
from acquisition.scenes.impacts import collision
from acquisition.scenes.runner import runner
from acquisition.scenes.scene import Scene
from acquisition.scenes.traffic import traffic
from acquisition.scenes.turntable import turntable

DEVELOPMENT_SEEDS = (1, 2, 3)
EVALUATION_SEEDS = (101, 102, 103)
_DEVELOPMENT = (fan_and_ball,)
_EVALUATION = (traffic, runner, turntable, collision, fan)
_STRESS = (
    stress.static,
    stress.stiff,
    stress.flicker,
    stress.outdoor,
    stress.dim,
    stress.bright,
    stress.burst,
    stress.deforming,
    stress.faint,
)
_CALIBRATION = (
    calibration.flat,
    calibration.dark,
    calibration.board_charuco,
    calibration.board_charuco_moving,
    calibration.board_april,
    calibration.board_april_moving,
)
DEVELOPMENT, EVALUATION, STRESS, CALIBRATION = (
    tuple(build.__name__ for build in builds) for builds in (_DEVELOPMENT, _EVALUATION, _STRESS, _CALIBRATION)
)
SCENES: dict[str, Callable[[int], Scene]] = {
    build.__name__: build for build in (*_DEVELOPMENT, *_EVALUATION, *_STRESS, *_CALIBRATION)
}


def build_scene(name: str, seed: int) -> Scene:
    """The scene `name`, its textures and small placements drawn from `seed`; an unknown name is a BadRecordingError."""
    if name not in SCENES:
        raise BadRecordingError(f"found the scene {name!r}", f"one of {', '.join(SCENES)}")
    if seed < 0:
        raise BadRecordingError(f"found the seed {seed}", "a whole number from 0")
    return SCENES[name](seed)
