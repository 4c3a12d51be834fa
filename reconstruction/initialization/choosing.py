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
LEAST_S = 15.0  # seconds of a training below which bodies are found in one way: the others take two


class Found(NamedTuple):
    """The bodies that were kept, how many were found in all ways, and their error over that of points at rest."""

    bodies: Bodies
    found: int
    ratio: float


class _Candidate(NamedTuple):
    """Body number `body` of `source`, its points [m], and by how many spikes it is nearer to the counts than rest."""

    source: Bodies
    body: int
    points: NDArray[np.int64]
    gain: float


def ways_within(seconds: float | None) -> Sequence[Way]:
    """Return the ways to find bodies for a training of so many seconds, None for one of given steps."""
    return SEVERAL if seconds is None or seconds >= LEAST_S else USUAL


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
    usual, judgement = tried[0]
    count = sum(len(found) for found, _ in tried)
    if len(tried) == 1:
        return Found(usual.only(judgement.kept), count, judgement.ratio)
    pool = [
        _Candidate(found, k, np.flatnonzero(found.owners == k), float(own.resting[k] - own.riding[k]))
        for found, own in tried
        for k in own.kept.tolist()
    ]
    resting = sum(float(own.resting[own.kept].sum()) for _, own in tried)
    riding = sum(float(own.riding[own.kept].sum()) for _, own in tried)
    return Found(_packed(usual, pool), count, riding / resting if resting else 1.0)


def _packed(usual: Bodies, pool: Sequence[_Candidate]) -> Bodies:
    """Return bodies of `pool` that share no point, those that explain most first; reasons are those of `usual`."""
    owners, chosen = np.full(len(usual.owners), -1), []
    left = list(pool)
    while left:
        free = [one.points[owners[one.points] < 0] for one in left]
        shares = [len(own) / len(one.points) for own, one in zip(free, left, strict=True)]
        worth = [
            (one.gain * share if one.gain > 0 else one.gain) if share >= LEFT and len(own) >= LEAST_POINTS else -np.inf
            for one, share, own in zip(left, shares, free, strict=True)
        ]
        best = int(np.argmax(worth))
        if worth[best] == -np.inf:
            break
        owners[free[best]] = len(chosen)
        chosen.append(left.pop(best))
    unlike = (owners < 0) & (usual.owners >= 0)
    reasons = np.where(unlike, np.array(UNLIKE, usual.reasons.dtype), np.where(owners < 0, usual.reasons, ""))
    nothing = usual.only(np.zeros(0, dtype=np.int64))
    kept = [one.source.only(np.array([one.body])) for one in chosen]
    quats, centers, seen = (
        np.concatenate([getattr(nothing, name), *(getattr(own, name) for own in kept)])
        for name in ("quats_wxyz", "centers", "seen")
    )
    return Bodies(owners, quats, centers, usual.instants_s, seen, reasons.astype(usual.reasons.dtype))
