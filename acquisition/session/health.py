"""Tells the operator how the cameras of a running session are doing."""

from collections import Counter
from collections.abc import Sequence

from acquisition.session.capture import Capture

_BUSY = 0.4  # share of the ring in use from which a pause of the disk will lose planes


def describe(captures: Sequence[Capture]) -> str:
    """Return all cameras in a few words: how many are well, and what is wrong with each other one."""
    unwell = [f"{capture.camera.id} {trouble}" for capture in captures if (trouble := _trouble(capture))]
    return ", ".join([f"{len(captures) - len(unwell)} of {len(captures)} cameras good", *unwell])


def _trouble(capture: Capture) -> str:
    """Return what is wrong with one camera, empty where nothing is."""
    if capture.failure:
        return f"failed after {capture.position} planes"
    if capture.contact.away:
        return f"lost after {capture.position} planes, looked for"
    lost: Counter[str] = Counter()
    for gap in capture.writer.gaps:
        lost[gap.layer] += gap.planes
    errors, ring = capture.contact.link.errors, capture.writer.ring.fullness
    if not lost and not errors and ring < _BUSY:
        return ""
    told = [f"{planes} lost ({layer})" for layer, planes in lost.items()]
    return ", ".join([*told, *([f"{errors} link errors"] if errors else []), f"ring {ring:.0%} full"])
