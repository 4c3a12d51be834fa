"""`sorting_hall`: a crane puts parcels on a bench; trolleys, a sign, a wheel and a ball come and go. Development."""

from __future__ import annotations

import numpy as np

from acquisition.scenes.bodies import UPRIGHT, about, at
from acquisition.scenes.passing import Carrier, Lane, Timetable
from acquisition.scenes.realistic.journeys import Delivery, Passer, delivered, passers
from acquisition.scenes.realistic.library import folder_of
from acquisition.scenes.realistic.meshes import ball, box, drum, read_obj, sheet
from acquisition.scenes.realistic.rooms.hall import Hall
from acquisition.scenes.realistic.setting import Finish, Setting, Thing

HALL = Hall(wide_m=3.3, high_m=1.6, low_m=0.72, deep_m=3.3)
SEED = 34
BENCH_TOP_Y_M, BENCH_Z_M = 0.1, 2.5
PARCEL_HALF_M = (0.13, 0.12, 0.11)
PLACES = tuple((x, BENCH_TOP_Y_M - PARCEL_HALF_M[1], BENCH_Z_M) for x in (0.1, -0.7))
ROD_M, PLATE_M = 0.6, 0.015  # half length of the crane's rod and half thickness of its plate
STEEL = Finish((0.0, 0.45), gloss=0.3)


def sorting_hall(seed: int) -> Setting:
    """Build the hall, its bench and its crane, and five things that pass at 8 to 18 m/s."""
    rng = np.random.default_rng([seed, SEED])
    times = Timetable(seed, SEED)
    walls = HALL.things(
        Finish((0.15, 0.8), "skimage/brick.png", 0.008, 2),
        Finish((0.2, 0.6)),
        Finish((0.05, 0.55), "skimage/gravel.png", 0.007),
    )
    crane = Delivery(
        "crane",
        [(box((0.02, ROD_M, 0.02)).moved(at(0, -ROD_M, 0)), STEEL), (box((0.16, PLATE_M, 0.13)), STEEL)],
        Carrier((0.0, PLATE_M + PARCEL_HALF_M[1], 0.0), (0.0, -0.3, 0.0), 0.5),
        PLACES,
        [(box(PARCEL_HALF_M), _photograph(name)) for name in ("coffee", "page")],
    )
    lamps = (HALL.lamp(-0.7, 1.2, (0.5, 0.3), 16.0), HALL.lamp(1.0, 2.2, (0.4, 0.4), 16.0))
    things = (*walls, *_furniture(rng), *delivered(times, crane), *passers(times, _passing()))
    return Setting(things, HALL.corners, lamps)


def _photograph(name: str) -> Finish:
    return Finish((0.06, 0.9), f"skimage/{name}.png", 0.004, 2)


def _furniture(rng: np.random.Generator) -> list[Thing]:
    x, z = rng.uniform(-0.04, 0.04, 2)
    low, half = HALL.low_m, (HALL.low_m - BENCH_TOP_Y_M) / 2
    wood = Finish((0.08, 0.55), "pybullet_data/table/table.png", 0.004, 2, gloss=0.3)
    cat = sheet((0.7 + x, -0.55, 3.28), (0.36, 0.0, 0.0), (0.0, -0.24, 0.0))
    return [
        Thing("bench", box((1.2, half, 0.17)).moved(at(0.0, BENCH_TOP_Y_M + half, BENCH_Z_M)), wood),
        Thing("post", drum(0.035, 0.6).moved(at(-0.6 + x, low - 0.6, 1.3, UPRIGHT.rotation)), _photograph("ihc")),
        Thing("locker", box((0.25, 0.42, 0.12)).moved(at(1.25, low - 0.42, 3.1 + z, about(1, -0.2))), STEEL),
        Thing("cat", cat, _photograph("chelsea")),
    ]


def _passing() -> list[Passer]:
    duck = read_obj(folder_of("pybullet_data") / "duck.obj").scaled(0.2)
    rider = duck.moved(at(0.1, -0.12, 0.0, about(0, -np.pi / 2)))
    yellow = Finish((0.05, 0.9), "pybullet_data/duckCM.png", 0.0, 4)
    crates = Finish((0.08, 0.85), "pybullet_data/jenga/jenga.png", 0.004, 2)
    return [
        ("trolley", Lane(0.44, 1.6, 0.36), [(box((0.36, 0.12, 0.1)), _photograph("coins")), (rider, yellow)]),
        ("sign", Lane(-0.3, 2.85, 0.6), [(box((0.45, 0.22, 0.02)), _photograph("astronaut"))]),
        ("wheel", Lane(0.3, 1.45, 0.24, rolls_m=0.24), [(drum(0.24, 0.04), _photograph("coffee"))]),
        (
            "cart",
            Lane(0.38, 2.05, 0.45),
            [
                (box((0.45, 0.17, 0.1)), crates),
                (box((0.2, 0.14, 0.09)).moved(at(0.11, -0.31, 0.0)), _photograph("page")),
            ],
        ),
        ("ball", Lane(0.5, 1.82, 0.2, 0.0, 0.2, 0.45, 1.1), [(ball(0.2), _photograph("ihc"))]),
    ]
