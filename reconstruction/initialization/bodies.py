"""Finds rigid bodies among the points of movers at a few instants: which points belong together, and how they moved.

Letters: I instants, n points. A body begins as a connected cluster, first where most are apart, and is followed from
instant to instant both ways by soft registration, in which points match that are near and alike in brightness; it
claims the points it explains, so clusters that touch elsewhere stay apart. What goes badly in one piece is tried in
parts, by a shorter link. What no body explains stays free; `judging` tells which bodies are none. Cost: a second of
one core for 1,500 points at 8 instants. Source: Myronenko & Song, "Point set registration: coherent point drift", PAMI
2010, with an intensity term.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from reconstruction.initialization.points import Points, nearest
from reconstruction.initialization.registration import ALIKE, linked, nearest_of, register, sampled
from rigs.transform import Transform

LEAST_POINTS = 40  # points of a cluster that may become a body
LINK = 3.0  # spacings within which points are one cluster
APART = 2 / 3  # of that, within which points are one cluster in a body that may be several
REACH = 2.5  # spacings within which a body explains a point
LEAST_SHARE = 0.4  # least share of its points that a body finds again; with fewer it is lost
SURE = 0.6  # share of points explained above which no second guess is tried
LEAST_INSTANTS = 3  # instants at which a body is seen at least
DOUBTFUL = 0.6  # correlation of brightness between points and their body below which it may be several
BETTER = 0.05  # least gain in that correlation of a body's parts over the body
TEXTURE = 0.02  # spread of brightness, spikes per tick, below which a body has no texture
LONE = f"in no cluster of {LEAST_POINTS} points"
SHORT = f"followed over fewer than {LEAST_INSTANTS} instants"
UNLIKE = "explains the counts between worse than points at rest"
LONGEST = max(map(len, (LONE, SHORT, UNLIKE)))
START = 0.15  # share of a body's radius by which a first guess may be off


@dataclass(eq=False)
class Body:
    """A rigid mover: its points in its own frame, and rig from body at the instants at which it was seen."""

    spacing: float  # m, of its points at one instant
    radius: float  # m, to its farthest point
    poses: dict[int, Transform]  # by number of the instant
    members: dict[int, NDArray[np.int64]] = field(default_factory=dict)  # indices into the points, by instant
    likeness: float = 1.0  # in brightness, of the points of one instant and those of the others, carried along

    @property
    def size(self) -> int:
        """The number of its points, of all instants."""
        return sum(map(len, self.members.values()))

    def model(self, points: Points, but: int | None = None) -> Points:
        """Return all its points in its own frame, without those of the instant `but`."""
        members = {i: m for i, m in self.members.items() if i != but}
        return Points.joined([points.select(m).moved(self.poses[i].inverse()) for i, m in members.items()])

    def predicted(self, instant: int) -> Transform:
        """Return its pose if it moved on as it did between the two nearest instants."""
        if instant in self.poses:
            return self.poses[instant]
        known = sorted(self.poses, key=lambda i: abs(i - instant))[:2]
        near = self.poses[known[0]]
        if len(known) < 2 or abs(known[0] - known[1]) != 1:
            return near
        step = near @ self.poses[known[1]].inverse()
        for _ in range(abs(instant - known[0])):
            near = step @ near
        return near


@dataclass(frozen=True, eq=False)
class Bodies:
    """The body that each of n points rides on (-1: none), and poses of K bodies at I instants, guessed where unseen."""

    owners: NDArray[np.int64]  # [n]
    quats_wxyz: NDArray[np.float64]  # [K, I, 4] rig from body, neighbours in one hemisphere
    centers: NDArray[np.float64]  # [K, I, 3] m, rig frame
    instants_s: NDArray[np.float64]  # [I]
    seen: NDArray[np.int64]  # [K, 2] number of the first and of the last instant at which it was seen
    reasons: NDArray[np.str_]  # [n] why a point is free, "" where it is not

    @property
    def attached(self) -> int:
        """The number of points that ride on a body."""
        return int((self.owners >= 0).sum())

    @property
    def free(self) -> dict[str, int]:
        """The number of points that ride on none, by reason."""
        names, counts = np.unique(self.reasons[self.owners < 0], return_counts=True)
        return dict(zip(names.tolist(), counts.tolist(), strict=True))

    def __len__(self) -> int:
        return len(self.seen)

    def only(self, kept: NDArray[np.int64]) -> "Bodies":
        """Return the bodies with the numbers `kept`, which rise; the points of the others are free."""
        numbers = np.full(len(self) + 1, -1)
        numbers[kept] = np.arange(len(kept))
        owners = numbers[self.owners]
        reasons = np.where((owners < 0) & (self.owners >= 0), np.array(UNLIKE, self.reasons.dtype), self.reasons)
        return Bodies(owners, self.quats_wxyz[kept], self.centers[kept], self.instants_s, self.seen[kept], reasons)

    def beside(self, resting: int) -> "Bodies":
        """Return the same bodies and one at rest, on which as many points more ride; themselves for 0."""
        if not resting:
            return self
        instants = len(self.instants_s)
        upright = np.tile([1.0, 0.0, 0.0, 0.0], (1, instants, 1))
        return Bodies(
            np.concatenate([self.owners, np.full(resting, len(self))]),
            np.concatenate([self.quats_wxyz, upright]),
            np.concatenate([self.centers, np.zeros((1, instants, 3))]),
            self.instants_s,
            np.concatenate([self.seen, [[0, instants - 1]]]),
            np.concatenate([self.reasons, np.zeros(resting, self.reasons.dtype)]),
        )


def find_bodies(points: Points, instants_s: Sequence[float], *, link: float = LINK, first: int | None = None) -> Bodies:
    """Return the rigid bodies among the points of movers that were swept at I instants (s), largest first.

    Clusters are of points within `link` spacings. The search begins at the instant number `first`, by default where
    most clusters are apart. A body that did not move as one piece may be several that touch, and is looked at once more
    by a shorter link.
    """
    instants = len(instants_s)
    owners, reasons = np.full(len(points), -1, dtype=np.int64), np.full(len(points), LONE, dtype=f"<U{LONGEST}")
    bodies: list[Body] = []
    positions, intensities = points.positions.astype(np.float32), points.intensities.astype(np.float32)
    single = replace(points, positions=positions, intensities=intensities)
    whole = _tracked(single, [np.flatnonzero(points.instants_s == instant_s) for instant_s in instants_s], link, first)
    parts = [part for one in whole for part in _torn(one, single, instants, APART * link)]
    for body in sorted(parts, key=lambda body: -body.size):
        reason = SHORT if _is_short(body, instants) else ""
        for members in body.members.values():
            reasons[members], owners[members] = reason, -1 if reason else len(bodies)
        if not reason:
            bodies.append(body)
    quats, centers = np.zeros((len(bodies), instants, 4)), np.zeros((len(bodies), instants, 3))
    for k, body in enumerate(bodies):
        for i in range(instants):
            pose = body.predicted(i)
            quat = pose.quat_wxyz
            quats[k, i] = -quat if i and quat @ quats[k, i - 1] < 0 else quat
            centers[k, i] = pose.translation
    seen = np.array([[min(b.members), max(b.members)] for b in bodies], dtype=np.int64).reshape(-1, 2)
    return Bodies(owners, quats, centers, np.array(instants_s, dtype=np.float64), seen, reasons)


def _torn(body: Body, points: Points, instants: int, link: float) -> list[Body]:
    """Return the parts of a doubtful body, clusters by `link`, where most of it moves better so; else it alone."""
    if len(body.members) < 2 or (body.likeness >= DOUBTFUL and not _is_short(body, instants)):
        return [body]
    nowhere = np.zeros(0, dtype=np.int64)
    parts = _tracked(points, [np.sort(body.members.get(i, nowhere)) for i in range(instants)], link)
    sure = [part for part in parts if not _is_short(part, instants)]
    sizes = np.array([part.size for part in sure], dtype=np.float64)
    if sizes.sum() < body.size / 2:
        return [body]
    likeness = float(np.average([part.likeness for part in sure], weights=sizes))
    return parts if likeness > body.likeness + BETTER else [body]


def _tracked(points: Points, swept: Sequence[NDArray[np.int64]], link: float, first: int | None = None) -> list[Body]:
    """Return the bodies among the points at indices `swept`, by instant, begun at `first` or where most are apart."""
    gaps = [_spacing(points.positions[which]) * link if len(which) >= LEAST_POINTS else 0.0 for which in swept]
    apart = [len(clusters(points, which, gap)) for which, gap in zip(swept, gaps, strict=True)]
    if first is None:
        first = int(np.argmax(apart)) if apart else 0
    bodies: list[Body] = []
    later, earlier = range(first, len(swept)), range(first - 1, -1, -1)
    for i, before in (*((i, i - 1) for i in later), *((i, i + 1) for i in earlier)):
        unclaimed = swept[i]
        for body in bodies:
            unclaimed = _follow(body, points, (i, before), unclaimed)
        bodies += [_begin(points, i, cluster) for cluster in clusters(points, unclaimed, gaps[i])]
        bodies.sort(key=lambda body: -body.size)
    for body in bodies:
        if len(body.members) > 1:
            _settle(body, points)
    return bodies


def _is_short(body: Body, instants: int) -> bool:
    """Return whether a body was followed too briefly to be trusted."""
    return len(body.members) < min(LEAST_INSTANTS, instants)


def clusters(points: Points, which: NDArray[np.int64], gap_m: float) -> list[NDArray[np.int64]]:
    """Return connected clusters of at least LEAST_POINTS among the points at indices `which`, largest first."""
    if len(which) < LEAST_POINTS:
        return []
    numbers = linked(points.positions[which], gap_m)
    found = [which[numbers == number] for number in np.flatnonzero(np.bincount(numbers) >= LEAST_POINTS)]
    return sorted(found, key=lambda c: -len(c))


def _begin(points: Points, instant: int, cluster: NDArray[np.int64]) -> Body:
    own = points.positions[cluster]
    pose = Transform(np.eye(3), torch.from_numpy(own).double().mean(dim=0).numpy())
    return Body(_spacing(own), float(_distances(own, pose).amax()), {instant: pose}, {instant: cluster})


def _follow(body: Body, points: Points, step: tuple[int, int], unclaimed: NDArray[np.int64]) -> NDArray[np.int64]:
    """Claim the points that the body explains at an instant, and return the others; a lost body claims none."""
    instant, before = step
    if len(unclaimed) < LEAST_POINTS or before not in body.members:
        return unclaimed
    model, target = sampled(body.model(points)), points.select(unclaimed)
    pose = _found(body, model, target, step)
    if pose is None:
        return unclaimed
    moved = model.moved(pose)
    mine = nearest_of(target, moved)[0] <= REACH * body.spacing
    again = float((nearest_of(moved, target)[0] <= REACH * body.spacing).mean())
    if int(mine.sum()) < LEAST_POINTS or again < LEAST_SHARE:
        return unclaimed
    body.poses[instant], body.members[instant] = pose, unclaimed[mine]
    return unclaimed[~mine]


def _found(body: Body, model: Points, target: Points, step: tuple[int, int]) -> Transform | None:
    """Return the better of two registrations: begun where the body would be had it moved on, and where it last was."""
    instant, before = step
    last, width = body.poses[before], max(START * body.radius, body.spacing)
    guesses = [last] if len(body.members) < 2 else [body.predicted(instant), last]
    best, most = None, -1.0
    for guess in guesses:
        near = target.select((_distances(target.positions, guess) <= body.radius + 3 * width).numpy())
        if len(near) < LEAST_POINTS:
            continue
        pose = register(model, sampled(near), guess, width, body.spacing)
        explained = _explained(near, model.moved(pose), REACH * body.spacing)
        if explained > most:
            best, most = pose, explained
        if most > SURE:
            break
    return best


def _explained(own: Points, others: Points, reach: float) -> float:
    """Return the share of the points that have another one as bright within `reach`."""
    near, which = nearest_of(own, others)
    alike = np.abs(own.intensities - others.intensities[which]) <= 2 * ALIKE
    return float(((near <= reach) & alike).mean())


def _settle(body: Body, points: Points) -> None:
    """Register every instant once more against all others, so that errors do not add up, and judge the outcome."""
    carried = []
    for instant in sorted(body.members):
        own, others = points.select(body.members[instant]), sampled(body.model(points, but=instant))
        pose = register(others, sampled(own), body.poses[instant], 1.5 * body.spacing, body.spacing)
        body.poses[instant] = pose
        carried.append(_likeness(own, others.moved(pose)))
    body.likeness = float(np.median(carried))


def _likeness(own: Points, others: Points) -> float:
    """Return the correlation in brightness of points and those nearest to them; 1 where there is no texture."""
    twins = others.intensities[nearest_of(own, others)[1]]
    a, b = (light - light.mean() for light in map(torch.from_numpy, (own.intensities, twins)))
    spread = float(a.square().mean().sqrt())
    if spread < TEXTURE:
        return 1.0
    return float((a * b).mean() / (a.square().mean() * b.square().mean()).sqrt().clamp_min(1e-12))


def _spacing(positions: NDArray[np.floating]) -> float:
    near, _ = nearest(positions, positions, min(4, len(positions)))
    return max(float(np.median(near[:, -1])), 1e-6)


def _distances(positions: NDArray[np.floating], pose: Transform) -> Tensor:
    """Return how far points [n, 3] are from the origin of a body, in float32."""
    return torch.from_numpy(positions - pose.translation.astype(np.float32)).norm(dim=1)
