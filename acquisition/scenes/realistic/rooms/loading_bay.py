"""`loading_bay`: an arm from the right puts drums on a shelf; boards, a roll, mugs and a crate pass. Evaluation."""

from __future__ import annotations

import numpy as np

from acquisition.scenes.bodies import UPRIGHT, about, at
from acquisition.scenes.passing import Carrier, Lane, Timetable
from acquisition.scenes.realistic.journeys import Delivery, Passer, delivered, passers
from acquisition.scenes.realistic.library import folder_of
from acquisition.scenes.realistic.meshes import ball, box, capsule, drum, read_obj, sheet
from acquisition.scenes.realistic.rooms.hall import Hall
from acquisition.scenes.realistic.setting import Finish, Setting, Thing

HALL = Hall(wide_m=3.4, high_m=1.5, low_m=0.8, deep_m=3.4)
SEED = 47
SHELF_TOP_Y_M, SHELF_Z_M = 0.18, 2.35
RADIUS_M, HALF_M = 0.13, 0.14  # of the drums
PLACES = tuple((x, SHELF_TOP_Y_M - HALF_M, SHELF_Z_M) for x in (-0.25, 0.35))
ARM_M, PALM_M = 1.2, 0.012  # half length of the arm and half thickness of its palm
GREY = Finish((0.0, 0.5), gloss=0.2)


def loading_bay(seed: int) -> Setting:
    """Build the bay, its shelf and its arm, and five things that pass at 8 to 18 m/s, two of them plain."""
    rng = np.random.default_rng([seed, SEED])
    times = Timetable(seed, SEED)
    walls = HALL.things(
        Finish((0.3, 0.75), "skimage/ihc.png", 0.007),
        Finish((0.1, 0.5)),
        Finish((0.08, 0.5), "skimage/grass.png", 0.008),
    )
    arm = Delivery(
        "arm",
        [(box((PALM_M, 0.1, 0.09)), GREY), (box((ARM_M, 0.025, 0.025)).moved(at(ARM_M, 0, 0)), GREY)],
        Carrier((-PALM_M - RADIUS_M, 0.0, 0.0), (0.0, -0.1, 0.0), 0.25, from_right=True),
        PLACES,
        [(drum(RADIUS_M, HALF_M).moved(at(0, 0, 0, UPRIGHT.rotation)), _picture(name)) for name in ("text", "brick")],
    )
    lamps = (HALL.lamp(0.8, 1.4, (0.3, 0.5), 20.0), HALL.lamp(-1.2, 1.9, (0.5, 0.3), 12.0))
    things = (*walls, *_furniture(rng), *delivered(times, arm), *passers(times, _passing()))
    return Setting(things, HALL.corners, lamps)


def _picture(name: str) -> Finish:
    return Finish((0.08, 0.85), f"skimage/{name}.png", 0.004, 2)


def _furniture(rng: np.random.Generator) -> list[Thing]:
    x, z = rng.uniform(-0.04, 0.04, 2)
    low, half = HALL.low_m, (HALL.low_m - SHELF_TOP_Y_M) / 2
    wood = Finish((0.1, 0.6), "pybullet_data/table/table.png", 0.004, 2)
    clock = sheet((-0.8 + x, -0.5, 3.38), (0.4, 0.0, 0.0), (0.0, -0.28, 0.0))
    return [
        Thing("shelf", box((0.8, half, 0.16)).moved(at(0.0, SHELF_TOP_Y_M + half, SHELF_Z_M)), wood),
        Thing("bollard", drum(0.05, 0.3).moved(at(0.75 + x, low - 0.3, 1.35, UPRIGHT.rotation)), _picture("gravel")),
        Thing("container", box((0.4, 0.5, 0.2)).moved(at(-1.4, low - 0.5, 3.0 + z, about(1, 0.25))), GREY),
        Thing("clock", clock, _picture("clock_motion")),
    ]


def _passing() -> list[Passer]:
    mug = read_obj(folder_of("pybullet_data") / "objects" / "mug.obj").scaled(2.4)
    cups = [mug.moved(at(x, -0.04, 0.0, about(0, np.pi / 2))) for x in (-0.2, 0.15)]
    dotted = Finish((0.08, 0.9), "pybullet_data/domino/domino.jpg", 0.004, 2)
    tray = [(box((0.4, 0.04, 0.14)), dotted), *((cup, Finish((0.0, 0.65), gloss=0.15)) for cup in cups)]
    return [
        ("tray", Lane(0.46, 1.55, 0.42), tray),
        ("board", Lane(0.05, 2.1, 0.42, turns_rad=0.5), [(box((0.42, 0.4, 0.02)), _picture("page"))]),
        ("roll", Lane(0.52, 1.85, 0.2, rolls_m=0.2), [(capsule(0.2, 0.12), _picture("gravel"))]),
        ("crate", Lane(-0.25, 1.6, 0.3, turns_rad=0.8), [(box((0.3, 0.16, 0.12)), Finish((0.0, 0.4), gloss=0.25))]),
        ("ball", Lane(0.5, 2.8, 0.24, 0.0, 0.24, 0.5, 1.3), [(ball(0.24), _picture("camera"))]),
    ]
