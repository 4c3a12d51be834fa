"""Finds rigid bodies in several ways, and keeps of all of them those that explain the most counts.

Which bodies are found hangs on the instant that one begins with and on how near points must be to be one cluster: no
choice is best for all. Letters: K bodies, n points.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from reconstruction.initialization.bodies import APART, LEAST_POINTS, LINK, UNLIKE, Bodies, find_bodies
from reconstruction.initialization.judging import Judgement
from reconstruction.initialization.points import Points
from reconstruction.parallel import each

LEFT = 0.5  # share of its points that others may have left to a body for it to be kept


class Way(NamedTuple):
    """A way to find bodies: `link` in spacings, and the share of the instants that lie before the `first` one.

    None begins where most clusters are apart.
    """

    link: float = LINK
    first: float | None = None


USUAL = (Way(),)
SEVERAL = (Way(), Way(link=APART * LINK), Way(first=0.5))
PART_S, WHOLE_S = 15.0, 30.0  # least seconds of a span, and of a run in one piece, in which several ways pay


class Found(NamedTuple):
    """The bodies that were kept, how many were found in all ways, and their error over that of points at rest."""

    bodies: Bodies
    found: int
    ratio: float


class _Candidate(NamedTuple):
    """Body number `body` of `source`, its points [m], and the errors of counts with it and with points at rest."""

    source: Bodies
    body: int
    points: NDArray[np.int64]
    riding: float
    resting: float

    def gain(self, owners: NDArray[np.int64]) -> float:
        """Return by how many spikes it is nearer to the counts than rest, on its points that have no owner yet.

        It is minus infinity where too few are left for it to be kept.
        """
        free = int((owners[self.points] < 0).sum())
        if free < max(LEAST_POINTS, LEFT * len(self.points)):
            return -np.inf
        gain = self.resting - self.riding
        return gain * free / len(self.points) if gain > 0 else gain


def ways_within(seconds: float | None, least_s: float) -> Sequence[Way]:
    """Return the ways to find bodies in so many seconds, None for given steps: one where there are under `least_s`."""
    return SEVERAL if seconds is None or seconds >= least_s else USUAL


def choose_bodies(
    points: Points, instants_s: Sequence[float], judge: Callable[[Bodies], Judgement], ways: Sequence[Way] = SEVERAL
) -> Found:
    """Return the bodies among the points of movers at I instants (s), found in all `ways` and judged by `judge`.

    The body that explains most is kept first; another one is kept if half of its points are on none yet.
    """

    def judged(way: Way) -> tuple[Bodies, Judgement]:
        first = None if way.first is None else int(way.first * len(instants_s))
        found = find_bodies(points, instants_s, link=way.link, first=first)
        return found, judge(found)

    tried = list(each(judged, ways))
    left = [
        _Candidate(found, k, np.flatnonzero(found.owners == k), float(own.riding[k]), float(own.resting[k]))
        for found, own in tried
        for k in own.kept.tolist()
    ]
    usual, chosen = tried[0][0], []
    owners = np.full(len(usual.owners), -1)
    while left:
        best = max(left, key=lambda one: one.gain(owners))
        if best.gain(owners) == -np.inf:
            break
        left = [one for one in left if one is not best]
        owners[best.points[owners[best.points] < 0]] = len(chosen)
        chosen.append(best)
    riding, resting = (sum(getattr(one, name) for one in chosen) for name in ("riding", "resting"))
    count = sum(len(found) for found, _ in tried)
    return Found(_joined(usual, owners, chosen), count, riding / resting if resting else 1.0)


def _joined(usual: Bodies, owners: NDArray[np.int64], chosen: Sequence[_Candidate]) -> Bodies:
    """Return the `chosen` bodies as one set whose points have these `owners` [n]; reasons are those of `usual`."""
    unlike = (owners < 0) & (usual.owners >= 0)
    reasons = np.where(unlike, np.array(UNLIKE, usual.reasons.dtype), np.where(owners < 0, usual.reasons, ""))
    parts = [usual.only(np.zeros(0, dtype=np.int64)), *(one.source.only(np.array([one.body])) for one in chosen)]
    quats, centers, seen = (
        np.concatenate([getattr(part, name) for part in parts]) for name in ("quats_wxyz", "centers", "seen")
    )
    return Bodies(owners, quats, centers, usual.instants_s, seen, reasons.astype(usual.reasons.dtype))
