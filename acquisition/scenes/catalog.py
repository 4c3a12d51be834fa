"""Lists the named scenes by their use: development, evaluation, stress, calibration.

Methods are chosen and tuned on DEVELOPMENT scenes with DEVELOPMENT_SEEDS. They are scored on EVALUATION scenes with
EVALUATION_SEEDS, which nothing is tuned on. OPEN_AIR scenes develop far, even and empty backgrounds. STRESS scenes have
one difficulty each; CALIBRATION ones calibrate a rig.
Every other list of scene names, as of the command line and the benches, is made from these.
"""

from collections.abc import Callable

from acquisition.errors import BadRecordingError
from acquisition.scenes import calibration
from acquisition.scenes.collision import collision
from acquisition.scenes.demo import fan_and_ball
from acquisition.scenes.fan import fan
from acquisition.scenes.open_air import black, far, sky
from acquisition.scenes.runner import runner
from acquisition.scenes.scene import Scene
from acquisition.scenes.stress import bright, burst, deforming, dim, faint, flicker, outdoor, plain, static, stiff
from acquisition.scenes.traffic import traffic
from acquisition.scenes.turntable import turntable

DEVELOPMENT_SEEDS = (1, 2, 3)
EVALUATION_SEEDS = (101, 102, 103)
SCENES: dict[str, Callable[[int], Scene]] = {}


def _listed(*builders: Callable[[int], Scene]) -> tuple[str, ...]:
    names = {build.__name__: build for build in builders}
    SCENES.update(names)
    return tuple(names)


DEVELOPMENT = _listed(fan_and_ball)
EVALUATION = _listed(traffic, runner, turntable, collision, fan)
OPEN_AIR = _listed(sky, far, black)
STRESS = _listed(static, stiff, flicker, outdoor, dim, bright, burst, deforming, faint, plain)
CALIBRATION = _listed(
    calibration.flat,
    calibration.dark,
    calibration.board_charuco,
    calibration.board_charuco_moving,
    calibration.board_april,
    calibration.board_april_moving,
)


def build_scene(name: str, seed: int) -> Scene:
    """Build the scene `name`, its textures and small placements drawn from `seed`.

    Raises BadRecordingError for an unknown name or a negative seed.
    """
    if name not in SCENES:
        raise BadRecordingError(f"found the scene {name!r}", f"one of {', '.join(SCENES)}")
    if seed < 0:
        raise BadRecordingError(f"found the seed {seed}", "a whole number from 0")
    return SCENES[name](seed)
