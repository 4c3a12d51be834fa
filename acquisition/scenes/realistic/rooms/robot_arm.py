"""`robot_arm`: an arm of seven links of plain plastic swings at a ball, beside a wheel of spokes and thin rods."""

from __future__ import annotations

import numpy as np

from acquisition.scenes.bodies import UPRIGHT, about, at
from acquisition.scenes.realistic.library import folder_of
from acquisition.scenes.realistic.meshes import Floats, Mesh, ball, box, drum, joined, read_obj
from acquisition.scenes.realistic.physics import STEPS, Thrown, World
from acquisition.scenes.realistic.rooms.hall import Hall
from acquisition.scenes.realistic.setting import KEYFRAME_S, KEYFRAMES, Finish, Setting, Thing, keyframes_s

HALL = Hall(wide_m=1.8, low_m=0.75, deep_m=3.1)
SEED = 33
BASE_M = (-0.25, 0.55, 1.95)
START_RAD = np.array([-0.75, 0.85, 0.3, -1.2, 0.2, 0.9, 0.0])  # of the joints at the first keyframe
RATES_RAD_S = np.array([7.0, 2.0, -3.0, -2.5, 6.0, -3.0, 9.0])
EASING_S = 0.12  # after which a joint would have turned by its rate, as a sine
SHADES = (0.75, 0.8, 0.35, 0.78, 0.4, 0.72, 0.3, 0.55)  # of the links


def robot_arm(seed: int) -> Setting:
    """Build the arm on its table, a ball in its way, a wheel of eight spokes at 25 rad/s, and rods before the wall."""
    rng = np.random.default_rng([seed, SEED])
    walls = HALL.things(
        Finish((0.35, 0.75), "skimage/gravel.png", 0.008),
        Finish((0.3, 0.7), "skimage/brick.png", 0.008),
        Finish((0.1, 0.55), "skimage/grass.png", 0.007),
    )
    lamps = (HALL.lamp(0.6, 1.3, (0.35, 0.35), 22.0), HALL.lamp(-1.1, 2.2, (0.2, 0.2), 26.0))
    return Setting((*walls, *_furniture(rng), *_arm_and_ball(rng), _wheel()), HALL.corners, lamps)


def _furniture(rng: np.random.Generator) -> list[Thing]:
    x, y, z = BASE_M
    wood = Finish((0.1, 0.6), "pybullet_data/table/table.png", 0.004, 2, gloss=0.3)
    coffee = Finish((0.05, 0.85), "skimage/coffee.png", 0.004, 3)
    things = [
        Thing("table", box((0.55, 0.1, 0.35)).moved(at(x + 0.1, y + 0.1, z)), wood),
        Thing("poster", box((0.4, 0.28, 0.01)).moved(at(0.7, -0.5, 3.08)), coffee),
    ]
    for number, x in enumerate((-1.25, -1.1, 1.15, 1.3)):
        rod = drum(0.012, 0.75, 16).moved(at(x + rng.uniform(-0.03, 0.03), 0.0, 2.6, UPRIGHT.rotation))
        things.append(Thing(f"rod{number}", rod, Finish((0.0, 0.15 + 0.2 * number))))
    return things


def _wheel() -> Thing:
    """Return a hub with eight spokes that end in knobs, facing the cameras a little askew."""
    spokes = []
    for k in range(8):
        turned = about(2, 2 * np.pi * k / 8)
        spokes.append(box((0.12, 0.011, 0.011)).moved(at(*(0.15 * turned[:, 0]), turned=turned)))
        spokes.append(ball(0.025, 12).moved(at(*(0.28 * turned[:, 0]), turned=turned)))
    wheel = joined(drum(0.05, 0.03), *spokes)
    instants_s = keyframes_s()
    place = np.array([0.72, 0.12, 2.0])
    poses = [np.c_[about(1, -0.3) @ about(2, 25.0 * t), place] for t in instants_s]
    return Thing("wheel", wheel, Finish((0.0, 0.7), gloss=0.25), np.stack(poses))


def _arm_and_ball(rng: np.random.Generator) -> list[Thing]:
    struck = ball(0.09)
    with World() as world:
        swing = Swing(world, START_RAD + rng.uniform(-0.03, 0.03, len(START_RAD)))
        aim = Thrown(struck, 0.25, (0.55, 0.16, 1.6), (-3.5, -0.2, 0.0), (4.0, 20.0, 6.0), 0.09)
        [flown] = world.run([world.add(aim)], swing)
    links = np.stack([np.stack(found) for found in swing.links[:KEYFRAMES]], axis=1)
    arm = [Thing("base", _mesh(0).moved(at(*BASE_M, turned=about(0, np.pi / 2))), _plastic(SHADES[0]))]
    arm += [Thing(f"link{k + 1}", _mesh(k + 1), _plastic(SHADES[k + 1]), poses) for k, poses in enumerate(links)]
    return [*arm, Thing("ball", struck, Finish((0.08, 0.9), "skimage/coins.png", 0.004, 2), flown)]


class Swing:
    """Drives the joints of an arm, and keeps where its `links` are at each keyframe; called before each step."""

    def __init__(self, world: World, start_rad: Floats):
        self.links: list[list[Floats]] = []
        self._world, self._start_rad = world, start_rad
        engine, client = world.engine, world.client
        stands = engine.getQuaternionFromEuler((np.pi / 2, 0.0, 0.0))  # its z along the rig's -y
        model = str(folder_of("pybullet_data") / "kuka_iiwa" / "model_free_base.urdf")
        self._robot = engine.loadURDF(model, BASE_M, stands, useFixedBase=True, physicsClientId=client)
        for joint, (angle, rate) in enumerate(zip(start_rad, RATES_RAD_S, strict=True)):
            engine.resetJointState(self._robot, joint, angle, rate, physicsClientId=client)
            engine.changeDynamics(self._robot, joint, restitution=0.5, physicsClientId=client)

    def __call__(self, step: int) -> None:
        """Set what the motors want, and note the links at each keyframe."""
        engine, client = self._world.engine, self._world.client
        turn = step * KEYFRAME_S / STEPS / EASING_S
        for joint, (angle, rate) in enumerate(zip(self._start_rad, RATES_RAD_S, strict=True)):
            wanted = {"targetPosition": angle + rate * EASING_S * np.sin(turn), "targetVelocity": rate * np.cos(turn)}
            gains = {"force": 3000, "positionGain": 0.3, "velocityGain": 1.0, "physicsClientId": client}
            engine.setJointMotorControl2(self._robot, joint, engine.POSITION_CONTROL, **wanted, **gains)
        if step % STEPS == 0:
            self.links.append([self._link(joint) for joint in range(len(self._start_rad))])

    def _link(self, joint: int) -> Floats:
        world = self._world
        found = world.engine.getLinkState(
            self._robot, joint, computeForwardKinematics=True, physicsClientId=world.client
        )
        return world.matrix(*found[4:6])


def _plastic(shade: float) -> Finish:
    return Finish((0.0, shade), gloss=0.25)


def _mesh(number: int) -> Mesh:
    return read_obj(folder_of("pybullet_data") / "kuka_iiwa" / "meshes" / f"link_{number}.obj")
