"""Writes the page of the speed bench: ends of runs, gains, times to a level, stages, and single steps."""

from collections.abc import Callable, Sequence
from itertools import groupby
from operator import itemgetter
from pathlib import Path

from acquisition.durable import write_durably
from reconstruction.bench.conventions import made_by
from reconstruction.bench.paper.tables import markdown
from reconstruction.bench.speed.run import NEW, OLD
from reconstruction.bench.speed.summary import (
    BEST,
    LEVELS,
    LOADED,
    PART,
    STAGE,
    STEPS,
    clips_of,
    differences,
    end_name,
    ends,
    level_seconds,
    levels_db,
    longest_pair,
    stages_of,
)

ABOUT = (
    "Both revisions in turns on one machine, a scene at a time; scenes may be sittings apart. "
    "A run is a process of its own; a point is the end of a "
    "run with that budget. Seconds are wall seconds from the start of the process to its last checkpoint. Idle threads "
    "sleep, as where the service runs a stage. `stolen`: share of the processors' time that other guests took."
)
GAINS = f"New runs less the longest old one, the one of the same budget, and `{BEST}`: each score's best of any budget."
END_FORMS = (
    ("psnr_db", "PSNR / dB", ".2f"),
    ("dynamic_psnr_db", "movers / dB", ".2f"),
    ("abs_rel", "Abs Rel", ".4f"),
    ("seconds", "seconds", ".1f"),
    ("steps", "steps", ",.0f"),
    ("gaussians", "Gaussians", ",.0f"),
    ("peak_mb", "memory / MB", ",.0f"),
    ("stolen", "stolen", ".3f"),
)
GAIN_FORMS = (("psnr_db", "+.2f"), ("dynamic_psnr_db", "+.2f"), ("abs_rel", "+.4f"))


def write_page(path: Path, document: dict) -> None:
    """Write the page of a document of the speed bench."""
    write_durably(path, page(document).encode())


def page(document: dict) -> str:
    """Return the page of a document of the speed bench."""
    rows = document["rows"]
    old = sorted({row["revision"] for row in rows if row["which"] == OLD})
    against = f" against {', '.join(old)}" if old else ""
    parts = [f"# {document['bench'].capitalize()}", made_by(document, against), ABOUT]
    for title, table in TABLES.items():
        found = table(document)
        parts += [f"## {title}", found] if found else []
    if document["omissions"]:
        parts += ["## Omissions", "\n".join(f"- {line}" for line in document["omissions"])]
    return "\n\n".join(parts) + "\n"


def _ends(document: dict) -> str:
    rows = document["rows"]
    lines = [
        [clip, end_name(row), *(format(row[key], form) if key in row else "" for key, _, form in END_FORMS)]
        for clip in clips_of(rows)
        for row in ends(rows, clip)
    ]
    return _table(("scene", "run", *(label for _, label, _ in END_FORMS)), lines)


def _gains(document: dict) -> str:
    """Return ends less ends: a gain in dB, a loss in depth where Abs Rel is positive; of old documents as of new."""
    found: dict[tuple[str, str], dict[str, float]] = {}
    for key, value in differences(document["rows"]).items():
        clip, _, rest = key.partition(".")
        pair, _, score = rest.rpartition(".")
        found.setdefault((clip, pair.replace("-", " - ")), {})[score] = value
    lines = [
        [*names, *(format(scores[key], form) if key in scores else "" for key, form in GAIN_FORMS)]
        for names, scores in found.items()
    ]
    table = _table(("scene", "run - run", "PSNR / dB", "movers / dB", "Abs Rel"), lines)
    return f"{GAINS}\n\n{table}" if any(BEST in name for _, name in found) else table


def _times(document: dict) -> str:
    """Return the least budgets that end at each level, or at each of several levels with the same answer."""
    rows, lines = document["rows"], []
    for clip in clips_of(rows):
        for (score, _), what in zip(LEVELS, ("whole", "movers"), strict=True):
            reached = [
                (level, [level_seconds(ends(rows, clip, which), score, level) for which in (OLD, NEW)])
                for level in levels_db(ends(rows, clip), score)
            ]
            for found, alike in groupby(reached, key=itemgetter(1)):
                first, *others = (str(level) for level, _ in alike)
                levels = f"{first} to {others[-1]}" if others else first
                lines.append([clip, what, levels, *("-" if s is None else f"{s:g}" for s in found)])
    return _table(("scene", "pixels", "level / dB", "old: least budget / s", "new: least budget / s"), lines)


def _stages(document: dict) -> str:
    lines = []
    for clip in clips_of(document["rows"]):
        pair = longest_pair(ends(document["rows"], clip))
        for stage in stages_of(pair) if pair else ():
            before, now = (row[f"{STAGE}{stage}"] for row in pair or ())
            ratio = f"{before / now:.2f}" if now else ""
            lines.append(
                [clip, f"{pair[0]['budget_s']:g}" if pair else "", stage, f"{before:.2f}", f"{now:.2f}", ratio]
            )
    return _table(("scene", "budget / s", "stage", "old / s", "new / s", "old / new"), lines)


def _steps(document: dict) -> str:
    summary, lines = document["summary"], []
    for row in (r for r in document["rows"] if r["part"] == STEPS and r["which"] == NEW):
        start = f"{STEPS}.{row['size']}"
        keys = [f"{start}.threads{row['threads']}.{k}" for k in ("old_ms", "new_ms", "x_old", "median_x_old")]
        shares = [f"{start}.{which}_serial_share" for which in (OLD, NEW)] if row["threads"] > 1 else ["", ""]
        forms = (".1f", ".1f", ".2f", ".2f", ".2f", ".2f")
        values = [format(summary[k], f) if k in summary else "" for k, f in zip([*keys, *shares], forms, strict=True)]
        lines.append([row["size"], str(row["threads"]), *values])
    columns = ("Gaussians and picture", "threads", "old / ms", "new / ms", "old / new", "of the medians")
    return _table((*columns, "old: serial share", "new: serial share"), lines)


def _profile(document: dict) -> str:
    """Return the milliseconds of each part of a step, and how many times as fast it is."""
    own = {(r["size"], r["threads"], r["which"]): r for r in document["rows"] if r["part"] == STEPS}
    lines = []
    for (size, threads, which), new in own.items():
        old = own.get((size, threads, OLD))
        if which != NEW or old is None:
            continue
        for key in (key for key in new if key.startswith(PART) and key in old):
            numbers = [f"{1e3 * old[key]:.2f}", f"{1e3 * new[key]:.2f}", f"{old[key] / new[key]:.2f}"]
            lines.append([size, str(threads), key.removeprefix(PART), *numbers])
    return _table(("Gaussians and picture", "threads", "part", "old / ms", "new / ms", "old / new"), lines)


def _loaded(document: dict) -> str:
    summary, lines = document["summary"], []
    for which in (OLD, NEW):
        if f"{LOADED}.{which}.slowdown" in summary:
            quiet, loaded, times = (summary[f"{LOADED}.{which}.{k}"] for k in ("quiet_ms", "loaded_ms", "slowdown"))
            lines.append([which, f"{quiet:.1f}", f"{loaded:.1f}", f"{times:.2f}"])
    return _table(("revision", "quiet / ms", "beside a busy thread / ms", "times as long"), lines)


def _table(columns: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    return markdown(columns, lines) if lines else ""


TABLES: dict[str, Callable[[dict], str]] = {
    "Ends of runs": _ends,
    "Gains": _gains,
    "Seconds to a level": _times,
    "Stages": _stages,
    "Single steps": _steps,
    "Parts of a step": _profile,
    "Beside a busy process": _loaded,
}
