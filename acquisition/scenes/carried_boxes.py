"""`carried_boxes`: a crane puts boxes on a bench while carts, a gondola and a hopping ball come and go. Development."""

from acquisition.scenes.bodies import Finish, at
from acquisition.scenes.long_stage import LongStage, Passer, cart
from acquisition.scenes.passing import Carrier, Lane
from acquisition.scenes.scene import Scene
from acquisition.scenes.stage import BLOCKS, CLOTH, DISCS, Stage

NUMBER = 31
FLOOR_Y_M = 0.62
BENCH_TOP_Y_M, BENCH_Z_M = 0.05, 2.42
BOX_HALF_M = (0.13, 0.12, 0.12)
PLACES = tuple((x, BENCH_TOP_Y_M - BOX_HALF_M[1], BENCH_Z_M) for x in (0.1, -0.75, 0.8, -0.35, 0.45))
FINE = tuple(Finish(picture, 0.003, (0.1, 1.0)) for picture in (DISCS, BLOCKS, CLOTH))
ROD_M, PLATE_M = 1.2, 0.015  # half length of the crane's rod and half thickness of its plate


def carried_boxes(seed: int) -> Scene:
    """Build a crane that brings five boxes to a bench; two carts, a gondola, a tray and a ball pass at 8 to 18 m/s."""
    stage = Stage.numbered(seed, NUMBER)
    stage.room(FLOOR_Y_M, Finish(DISCS, 0.008, (0.03, 0.7)), Finish(BLOCKS, 0.006, (0.03, 0.7)))
    bench = (1.3, (FLOOR_Y_M - BENCH_TOP_Y_M) / 2, 0.18)
    stage.block("bench", (0.0, (FLOOR_Y_M + BENCH_TOP_Y_M) / 2, BENCH_Z_M), bench, Finish(CLOTH, 0.006, (0.05, 0.7)))
    stage.pillar("post", stage.near(-0.6, 0.1, 1.3), 0.035, 0.6, Finish(BLOCKS, 0.003, (0.05, 0.9)))
    stage.block("locker", stage.near(1.2, 0.2, 3.2), (0.25, 0.42, 0.12), Finish(CLOTH, 0.007, (0.05, 0.8)), -0.2)
    stage.marker((-0.95, -0.55, 3.1), 0.1)
    long = LongStage(stage, seed, NUMBER)
    rod = stage.shape("box", (0.02, ROD_M, 0.02), FINE[1], at(0, -ROD_M, 0))
    plate = stage.shape("box", (0.16, PLATE_M, 0.14), FINE[2])
    crane = Carrier((0.0, PLATE_M + BOX_HALF_M[1], 0.0), (0.0, -0.3, 0.0), 0.5)
    boxes = [stage.shape("box", BOX_HALF_M, FINE[i % 3]) for i in range(len(PLACES))]
    long.boxes("crane", (rod, plate), crane, PLACES, boxes)
    long.passers(_things(stage))
    return long.scene("carried_boxes")


def _things(stage: Stage) -> tuple[Passer, ...]:
    hanger = stage.shape("box", (0.015, 0.6, 0.015), FINE[1], at(0, -0.8, 0))
    near = cart(stage, (0.36, 0.12, 0.1), (0.2, 0.11, 0.08), (FINE[0], FINE[1]))
    far = cart(stage, (0.45, 0.17, 0.1), (0.2, 0.14, 0.09), (FINE[1], FINE[2]))
    return (
        ("near_cart", Lane(0.38, 1.6, 0.36), near),
        ("gondola", Lane(-0.3, 2.85, 0.6), (stage.shape("box", (0.45, 0.22, 0.1), FINE[2]), hanger)),
        ("tray", Lane(-0.1, 1.42, 0.24, turns_rad=0.7), (stage.shape("box", (0.24, 0.12, 0.01), FINE[0]),)),
        ("far_cart", Lane(0.3, 2.05, 0.45), far),
        ("ball", Lane(0.4, 1.82, 0.2, 0.0, 0.2, 0.45, 1.1), (stage.shape("sphere", (0.2,), FINE[0]),)),
    )
