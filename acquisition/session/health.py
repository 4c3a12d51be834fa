"""Tells the operator how each camera of a running session is doing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from acquisition.session.capture import Capture

_BUSY = 0.4  # share of the ring in use from which a pause of the disk will lose planes


@dataclass(frozen=True)
class CameraHealth:
    """One camera: planes received, planes lost, the part of its ring in use, and why it stopped, if it did.

    `link_errors` counts packets its link had to send again; `away`: it was lost, and is looked for.
    """

    camera_id: str
    planes: int
    lost: dict[str, int]
    ring: float
    failure: str | None
    link_errors: int = 0
    away: bool = False

    @property
    def good(self) -> bool:
        """Return whether there is nothing to tell."""
        return not (self.failure or self.lost or self.link_errors or self.away) and self.ring < _BUSY

    def __str__(self) -> str:
        if self.failure:
            return f"{self.camera_id} failed after {self.planes} planes"
        if self.away:
            return f"{self.camera_id} lost after {self.planes} planes, looked for"
        errors = f"{self.link_errors} link errors" if self.link_errors else ""
        lost = ", ".join(f"{planes} lost ({layer})" for layer, planes in self.lost.items())
        return f"{self.camera_id} " + ", ".join(filter(None, (lost, errors, f"ring {self.ring:.0%} full")))


def health_of(capture: Capture) -> CameraHealth:
    """Return the health of one camera now."""
    lost: dict[str, int] = {}
    for gap in capture.writer.gaps:
        lost[gap.layer] = lost.get(gap.layer, 0) + gap.planes
    failure = str(capture.failure) if capture.failure else None
    errors, away = (capture.contact.link.errors, capture.contact.away) if capture.contact else (0, False)
    return CameraHealth(capture.camera.id, capture.position, lost, capture.writer.ring.fullness, failure, errors, away)


def describe(captures: Sequence[Capture]) -> str:
    """Return all cameras in a few words: how many are well, and what is wrong with each other one."""
    found = [health_of(capture) for capture in captures]
    unwell = [str(health) for health in found if not health.good]
    return ", ".join([f"{len(found) - len(unwell)} of {len(found)} cameras good", *unwell])
