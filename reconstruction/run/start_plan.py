"""Decides where the cameras and the points come from that a training starts with."""

from reconstruction.errors import BadRunError
from reconstruction.initialization.initialisers import FINDING_POINTS
from reconstruction.methods.definition import Method
from reconstruction.run.configuration import FOUND, SWEPT, ReconstructionConfig
from reconstruction.run.decisions import Decision
from reconstruction.run.prices import Work
from rigs.rig import Rig

PUBLISHED_POINTS = "msdi"  # the initialiser whose points are part of its method


def init_of(config: ReconstructionConfig, rig: Rig) -> str:
    """Return the name of the initialiser."""
    return config.init if config.init != "auto" else "natural" if rig.poses == "nominal" else "sweep"


def choose_init(config: ReconstructionConfig, rig: Rig, work: Work, decisions: list[Decision]) -> str:
    """Return the name of the initialiser, and say so where nobody asked for it."""
    init = init_of(config, rig)
    if config.dust3r_checkpoint and init != "dust3r":
        decisions.append(Decision("checkpoint", "not read", f"the poses are those of {init}", "--init dust3r"))
    if config.init != "auto":
        return init
    choice = "found by natural" if init == "natural" else "not estimated"
    spared_s = None if init == "natural" else work.poses_s()
    decisions.append(Decision("poses", choice, f"the rig's poses are {rig.poses}", "--init", spared_s))
    return init


def choose_points(config: ReconstructionConfig, init: str, method: Method, decisions: list[Decision]) -> str:
    """Return where points come from: MSDI's where a baseline has MSDI, as it is published, else our sweep's."""
    points = config.points
    if points == FOUND and init not in FINDING_POINTS:
        expected, do = f"one that finds points: {', '.join(FINDING_POINTS)}", f"leave out --points {FOUND}"
        raise BadRunError(f"found --points {FOUND} with the poses of {init}", expected, do)
    if points == "auto" and init in FINDING_POINTS:
        points = FOUND if init == PUBLISHED_POINTS and not method.ours else SWEPT
        reason = "they are part of the published method" if points == FOUND else f"those of {init} are worse or fewer"
        decisions.append(Decision("points", points, reason, "--points"))
    return SWEPT if points == "auto" else points
