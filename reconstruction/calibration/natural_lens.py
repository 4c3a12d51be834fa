"""The bend of lenses from an ordinary scene: k1, then k2, alike for all cameras, where the observations determine them.

A value is freed beside poses and focal length and stays free where it is far from the rig file's in its own standard
deviations and moves the picture's corners. Else the solution before it is returned as it was.
"""

from dataclasses import replace

import numpy as np

from reconstruction.calibration.adjustment import Solution, adjust, covariance
from reconstruction.calibration.calibrated import OPTIMISM
from reconstruction.calibration.projection import BENDS
from rigs.lens import shortened
from rigs.rig import Rig

SHARED: tuple[str, ...] = ("k1", "k2")  # in the order in which they are freed
DISTORTION_SD = 0.3  # prior deviation of either
SURE = 5.0  # least value, in its standard deviations
LEAST_PX = 0.5  # least change of the picture's corners
NEAR_PX = 2.0  # change of the corners that gates and verification of matches bear
STEPS = 40


def lens_groups(solution: Solution) -> tuple[str, ...]:
    """Return the parts of the lens that are free in a solution."""
    return tuple(name for name in SHARED if name in solution.problem.freedom.groups)


def rebends(solution: Solution) -> bool:
    """Tell whether a solution's lens is so far from the one it began with that matches are to be judged anew."""
    return any(_moved_px(solution, name) > NEAR_PX for name in lens_groups(solution))


def with_lens(solution: Solution) -> Solution:
    """Return the solution with one more part of the lens free after another, as long as they are significant."""
    if len(set(solution.state.cameras.fisheye.tolist())) > 1:
        return solution  # k1 of one model is not that of the other
    for name in SHARED[len(lens_groups(solution)) :]:
        problem = replace(solution.problem, freedom=solution.problem.freedom.shared(name, DISTORTION_SD))
        state = replace(solution.state, steps=np.append(solution.state.steps, 0.0))
        freed = Solution(problem, adjust(problem, state, STEPS))
        if _moved_px(freed, name) < LEAST_PX or abs(freed.moved(name)) < SURE * sd_of(freed, name):
            return solution
        solution = freed
    return solution


def sd_of(solution: Solution, name: str) -> float:
    """Return the standard deviation of a free part of the lens."""
    at = solution.problem.freedom.of(name).item()
    return float(np.sqrt(OPTIMISM * covariance(solution.problem, solution.state)[at, at]))


def with_lens_of(rig: Rig, solution: Solution) -> Rig:
    """Return `rig` with the bends of its lenses as in a solution."""
    bends = solution.state.cameras.lenses[:, BENDS]
    pairs = zip(rig.cameras, bends, strict=True)
    return replace(rig, cameras=tuple(replace(c, distortion=shortened(tuple(map(float, k)))) for c, k in pairs))


def lens_report(solution: Solution, found: Rig, nominal: Rig) -> dict[str, object]:
    """Return what a report says of the lenses that were `found`, as plain values."""
    names = lens_groups(solution)
    if not names:
        return {"distortion": "as in the rig file: the scene shows no other"}
    pairs = zip(found.cameras[0].distortion, nominal.cameras[0].distortion, strict=False)
    changes = dict(zip(SHARED, (now - then for now, then in pairs), strict=False))
    sds = {name: sd_of(solution, name) for name in names}
    said = ", ".join(f"{name} {changes[name]:+.4f} +- {sds[name]:.4f}" for name in names)
    report: dict[str, object] = {"distortion": f"{said} from the rig file, alike for all cameras"}
    for name in names:
        report |= {f"{name}_change": changes[name], f"{name}_sd": sds[name]}
    return report


def _moved_px(solution: Solution, name: str) -> float:
    """Return how far the last part of the lens moves the picture's corners at most, the centre and slopes held."""
    lenses = solution.state.cameras.lenses
    across = float(np.hypot(*(lenses[:, 2:4] / lenses[:, :2]).T).max())  # about as far as the corners
    power = 2 * SHARED.index(name) + 3
    return abs(solution.moved(name)) * across**power * float(lenses[:, 0].max())
