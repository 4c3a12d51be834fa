"""Turns the rows of the speed bench into named numbers: gains, times to a level, ratios of stages and of steps."""

import math
from collections.abc import Iterable, Sequence

from reconstruction.bench.speed.run import NEW, OLD, SCORES

ENDS, STEPS, LOADED = "ends", "steps", "loaded"
LEVELS = (("psnr_db", "seconds_to"), ("dynamic_psnr_db", "movers_seconds_to"))
END_FIGURES = (*SCORES, "seconds", "steps", "peak_mb")
LEAST_STAGE_S = 0.1  # seconds below which the ratio of a stage is left out
BEST = f"{OLD}@best"  # name of the best old scores
DEPTH = "abs_rel"  # the score of which less is better
PART = "part_s."  # start of the name of the seconds of a part of a step in a row
STAGE = "seconds."  # start of the name of a stage's seconds in a row


def summarise(rows: Sequence[dict]) -> dict[str, float]:
    """Return the whole summary of the rows that there are."""
    found: dict[str, float] = {}
    for clip in clips_of(rows):
        own = ends(rows, clip)
        for row in own:
            start = f"{clip}.{end_name(row)}"
            found |= {f"{start}.{name}": row[name] for name in END_FIGURES if name in row}
        found |= _levels(clip, own) | _stages(clip, own)
    return found | differences(rows) | _steps(rows) | _loaded(rows)


def clips_of(rows: Iterable[dict]) -> list[str]:
    """Return the names of the clips that have whole runs, in their order."""
    return list(dict.fromkeys(row["clip"] for row in rows if row["part"] == ENDS))


def ends(rows: Iterable[dict], clip: str, which: str | None = None) -> list[dict]:
    """Return the whole runs of a clip, of one contender or of both, shortest budget first."""
    own = [r for r in rows if r["part"] == ENDS and r["clip"] == clip and which in (None, r["which"])]
    return sorted(own, key=lambda row: row["budget_s"])


def end_name(row: dict) -> str:
    """Return what a summary calls the end of a run: its contender and budget."""
    return f"{row['which']}@{row['budget_s']:g}"


def longest_pair(rows: Sequence[dict]) -> tuple[dict, dict] | None:
    """Return the old and the new run of the longest budget that both have; None where there is none."""
    by_end = {(row["which"], row["budget_s"]): row for row in rows}
    both = [budget for which, budget in by_end if which == OLD and (NEW, budget) in by_end]
    return (by_end[OLD, max(both)], by_end[NEW, max(both)]) if both else None


def differences(rows: Sequence[dict]) -> dict[str, float]:
    """Return all differences of two ends of a clip by their names, and the least of each over the clips."""
    found: dict[str, float] = {}
    for clip in clips_of(rows):
        own = ends(rows, clip)
        found |= _gains(clip, own) | _patience(clip, own)
    return found | least(found)


def _gains(clip: str, rows: Sequence[dict]) -> dict[str, float]:
    """Return how far every new run ends above old ones, and below them in depth: new less old.

    These are the old run of the same budget, the longest one, and BEST: of each score the best old run, at any budget.
    """
    old, new = ([row for row in rows if row["which"] == which] for which in (OLD, NEW))
    if not old:
        return {}
    found, same = _less(clip, new, old[-1]), {row["budget_s"]: row for row in old}
    for row in new:
        found |= _less(clip, [row], same[row["budget_s"]]) if row["budget_s"] in same else {}
    known = {score: [row[score] for row in old if score in row] for score in SCORES}
    best = {score: (min if score == DEPTH else max)(values) for score, values in known.items() if values}
    return found | _less(clip, new, best, BEST)


def _patience(clip: str, rows: Sequence[dict]) -> dict[str, float]:
    """Return how far the longest new run ends above the one before it, and below it in depth: longer less shorter."""
    new = [row for row in rows if row["which"] == NEW]
    return _less(clip, new[-1:], new[-2]) if len(new) > 1 else {}


def _less(clip: str, rows: Sequence[dict], other: dict, name: str = "") -> dict[str, float]:
    """Return the scores of runs less those of another one, by the names of both; `name` is another name of it."""
    return {
        f"{clip}.{end_name(row)}-{name or end_name(other)}.{score}": row[score] - other[score]
        for row in rows
        for score in SCORES
        if score in row and score in other
    }


def least(found: dict[str, float]) -> dict[str, float]:
    """Return the least gain in dB over all clips, by its two ends and its score."""
    gains: dict[str, list[float]] = {}
    for key, value in found.items():
        if compared(key) and key.endswith("psnr_db"):
            gains.setdefault(key.partition(".")[2], []).append(value)
    return {f"least.{name}": min(values) for name, values in gains.items()}


def compared(key: str) -> bool:
    """Tell whether a number of the summary is a difference of two ends."""
    return any(f"-{which}@" in key for which in (OLD, NEW))


def level_seconds(rows: Sequence[dict], score: str, level_db: float) -> float | None:
    """Return the least budget whose run ends at a level or above; None where none does."""
    return min((row["budget_s"] for row in rows if row.get(score, -math.inf) >= level_db), default=None)


def levels_db(rows: Sequence[dict], score: str) -> range:
    """Return the whole dB from the worst end's to the best end's."""
    known = [row[score] for row in rows if score in row and math.isfinite(row[score])]
    return range(math.floor(min(known)), math.floor(max(known)) + 1) if known else range(0)


def _levels(clip: str, rows: Sequence[dict]) -> dict[str, float]:
    found = {
        f"{clip}.{which}.{name}_{level}": level_seconds([r for r in rows if r["which"] == which], score, level)
        for score, name in LEVELS
        for level in levels_db(rows, score)
        for which in (OLD, NEW)
    }
    return {key: seconds for key, seconds in found.items() if seconds is not None}


def _stages(clip: str, rows: Sequence[dict]) -> dict[str, float]:
    """Return how many times as fast each stage is, and how many times as many steps fit, at the longest budget."""
    pair = longest_pair(rows)
    if pair is None:
        return {}
    old, new = pair
    found = {f"{clip}.steps_x_old": new["steps"] / old["steps"]}
    for stage in stages_of(pair):
        before, now = (row[f"{STAGE}{stage}"] for row in pair)
        if min(before, now) >= LEAST_STAGE_S and stage != "train":  # training takes what the budget leaves
            found[f"{clip}.{stage}_x_old"] = before / now
    return found


def stages_of(rows: Sequence[dict]) -> list[str]:
    """Return the stages whose seconds all rows have."""
    first, *others = rows
    names = [key for key in first if key.startswith(STAGE) and all(key in row for row in others)]
    return [name.removeprefix(STAGE) for name in names]


def _steps(rows: Sequence[dict]) -> dict[str, float]:
    """Return milliseconds, ratios to the old revision, and the serial share of steps."""
    found: dict[str, float] = {}
    own = {(r["size"], r["threads"], r["which"]): r for r in rows if r["part"] == STEPS}
    for (size, threads, which), row in own.items():
        start = f"{STEPS}.{size}.threads{threads}"
        found |= {f"{start}.{which}_ms": 1e3 * row["seconds"], f"{start}.{which}_median_ms": 1e3 * row["median_s"]}
        old, single = own.get((size, threads, OLD)), own.get((size, 1, which))
        if which == NEW and old:
            found |= {f"{start}.x_old": old["seconds"] / row["seconds"]}
            found |= {f"{start}.median_x_old": old["median_s"] / row["median_s"]}
        if threads > 1 and single:
            share = serial_share(single["seconds"], row["seconds"], threads)
            found[f"{STEPS}.{size}.{which}_serial_share"] = share
    return found


def serial_share(single_s: float, several_s: float, threads: int) -> float:
    """Return the share of a step on one thread that more threads do not speed up (Amdahl).

    `single_s` and `several_s` are seconds on one thread and on `threads`. Noise may take it below 0.
    """
    return (threads * several_s / single_s - 1) / (threads - 1)


def _loaded(rows: Sequence[dict]) -> dict[str, float]:
    """Return how many times as long a step takes beside a busy process, and the ratio to the old revision there.

    Medians: the fastest step beside a load is one that the load did not meet.
    """
    own = {(r["which"], r["loaded"]): r["median_s"] for r in rows if r["part"] == LOADED}
    found = {
        f"{LOADED}.{which}.slowdown": own[which, True] / own[which, False]
        for which in (OLD, NEW)
        if (which, True) in own
    }
    for load, name in ((True, "loaded"), (False, "quiet")):
        found |= {f"{LOADED}.{which}.{name}_ms": 1e3 * s for (which, under), s in own.items() if under == load}
    if {(OLD, True), (NEW, True)} <= own.keys():
        found[f"{LOADED}.x_old"] = own[OLD, True] / own[NEW, True]
    return found
