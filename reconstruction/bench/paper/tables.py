"""Writes the tables as Markdown: ours, spread, run time, and beside it the paper's figure, which is of other scenes."""

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from acquisition.bench_document import machines_of, revisions_of
from acquisition.durable import write_durably
from reconstruction.bench.conventions import means
from reconstruction.bench.paper.bench import NOT_RUN, lacks_runs
from reconstruction.bench.paper.method import Cell, Protocol, Row, Table
from reconstruction.bench.paper.published import PUBLISHED, Figures
from reconstruction.bench.paper.summary import gaps, name_of

PAPER = "paper (other scenes)"
COLUMNS = (
    *("row", "at", "PSNR / dB", "to the first row", "spread", "movers / dB", "SSIM", "Abs Rel", "within 1.25"),
    *("Gaussians", "seconds", "runs", PAPER),
)
ABOUT = (
    "To the first row: dB, on the recordings that both have; none where they ran on unlike processors. Spread: lowest "
    "to highest of the recordings; ± the deviation over seeds of one scene."
)
LIMITS = (
    "Small 4DGS: a grid of 32 and 64 cells with 25 steps in time and a width of 64, where 64 and 128, 150 and 128 are "
    "published; opacity and colour are not deformed. `rivals` has the published field.",
    "D3DGS has 13 timesteps and some 3,000 steps in all, where 10,000 and 2,000 a timestep are published.",
    "Small Spk2ImgNet has 0.2 M parameters and no alignment; small MSDI trained for four hours on simulated "
    "scenes, in older rows for less.",
    "Image variation compares renders with target images; SPSS, as we read the paper (decision 151), spikes made of "
    "renders with recorded spikes.",
    "Ours has images of nine planes, deblurring, held depths, and rigid bodies, as the scenes have; the baselines have "
    "TFI images. Movers are swept at four instants for our bodies, at eight for STG and straight paths, at one for "
    "fields and D3DGS.",
    "Still images and kernels are ours in every row, and points where a row names no others.",
    "Methods that know motion train at rates searched alike on development scenes.",
    "The images of networks stand at every 40th plane, as one takes half a second; clean and blurred ones at every "
    "20th, where rows are scored; others at every fourth. So rows of clean images are no bound.",
)
FORMS = (
    ("psnr_db", ".2f"),
    ("dynamic_psnr_db", ".2f"),
    ("ssim", ".3f"),
    ("abs_rel", ".4f"),
    ("delta_1_25", ".3f"),
    ("gaussians", ",.0f"),
    ("seconds", ".1f"),
)
HOW = {  # form of every published figure, with its unit
    "psnr_db": "{:.2f} dB",
    "ssim": "SSIM {:.3f}",
    "abs_rel": "Abs Rel {:.3f}",
    "delta_1_25": "{:.3f} within 1.25",
    "rotation_deg": "{:.2f} deg",
    "translation_percent": "{:.1f} %",
    "brisque": "BRISQUE {:.2f}",
    "niqe": "NIQE {:.2f}",
    "seconds": "{:.0f} s",
}


def write_tables(path: Path, document: dict, protocol: Protocol) -> None:
    """Write `paper.md`: the tables of which no run is left to be made, and the omissions."""
    parts = [_head(document), "What the rows are not:\n" + "\n".join(f"- {line}" for line in LIMITS)]
    parts += whole_tables(document, protocol)
    stress = {cell.name for table in protocol.tables if table.name == "stress" for cell in _cells(protocol, table)}
    if stress and not unprinted(document, ("stress",)):
        parts.append(_scene_table([row for row in document["rows"] if name_of(row) in stress]))
    parts += [omitted(document), sittings(document["rows"])]
    write_durably(path, ("\n\n".join(parts) + "\n").encode())


def whole_tables(document: dict, protocol: Protocol) -> list[str]:
    """Return the tables of which no run is left to be made, and a line that names the others."""
    lacking = unprinted(document, (table.name for table in protocol.tables))
    found = [measured_table(t, protocol, document["rows"]) for t in protocol.tables if t.name not in lacking]
    named = ", ".join(table.name for table in protocol.tables if table.name in lacking)
    return [*found, *([f"Tables that still lack runs, and are not printed: {named}."] if lacking else [])]


def unprinted(document: dict, tables: Iterable[str]) -> set[str]:
    """Return the names of those tables that still lack runs."""
    return {name for name in tables if lacks_runs(document["omissions"], name)}


def omitted(document: dict) -> str:
    """Return the omissions of a document, but for runs that are left to be made."""
    return "## Omissions\n\n" + "\n".join(f"- {line}" for line in document["omissions"] if NOT_RUN not in line)


def _cells(protocol: Protocol, table: Table) -> list[Cell]:
    return [cell for row in table.rows for cell in protocol.wanted(table, row)]


def measured_table(table: Table, protocol: Protocol, rows: Sequence[dict]) -> str:
    """Return one table of runs: a line for each row and each length that was run, means over recordings."""
    lines, absent = [], []
    cells = _cells(protocol, table)
    for row in table.rows:
        own = protocol.wanted(table, row)
        efforts = sorted({cell.effort for cell in own}, key=lambda e: (e.budget_s or 0, e.steps or 0))
        found = [(effort, [cell for cell in own if cell.effort == effort]) for effort in efforts]
        measured = [_line(table, row, wanted, rows) for _, wanted in found if _of(wanted, rows)]
        lines += measured
        absent += [] if measured else [row.label]
    missing = len(cells) - len(_of(cells, rows))
    parts = [f"## {table.title} (`{table.name}`)", f"{table.about} {ABOUT}"]
    if missing:
        parts[-1] += f" **{missing} runs were refused or failed; the omissions say which.**"
    parts += [markdown(COLUMNS, lines)] if lines else []
    parts += [f"Without a measurement: {'; '.join(absent)}."] if absent else []
    return "\n\n".join(parts)


def markdown(columns: Sequence[str], lines: Iterable[Sequence[str]]) -> str:
    """Return a table in GitHub's Markdown."""
    return "\n".join(f"| {' | '.join(line)} |" for line in [columns, ["---"] * len(columns), *lines])


def sittings(rows: Iterable[dict]) -> str:
    """Return a table of days, revisions and machines, with the runs and hours of each."""
    lines: dict[tuple[str, ...], list[float]] = {}
    for row in rows:
        if "revision" in row:
            day, machine = row.get("day", "not kept"), f"{row['processor']}, {row['threads']} threads"
            lines.setdefault((day, row["revision"], machine), []).append(float(row.get("seconds") or 0.0))
    shown = [(*key, f"{len(own)}", f"{sum(own) / 3600:.1f}") for key, own in sorted(lines.items())]
    return "## Sittings\n\n" + markdown(("day", "revision", "machine", "runs", "hours"), shown)


def _of(cells: Sequence[Cell], rows: Sequence[dict]) -> list[dict]:
    names = {cell.name for cell in cells}
    return [row for row in rows if name_of(row) in names]


def _line(table: Table, row: Row, wanted: Sequence[Cell], rows: Sequence[dict]) -> list[str]:
    found = _of(wanted, rows)
    kept = f", {sum('kept' in r for r in found)} of other code" if any("kept" in r for r in found) else ""
    level, *figures = [_mean(found, metric, form) for metric, form in FORMS]
    about = level, _to_first(table, row, found, rows), _spread(found)
    runs = f"{len(found)} of {len(wanted)}{kept}"
    return [row.label, str(wanted[0].effort), *about, *figures, runs, _paper(table, row)]


def _to_first(table: Table, row: Row, found: Sequence[dict], rows: Sequence[dict]) -> str:
    first = table.rows[0].method
    if row.method is None or first is None or row.method == first:
        return ""
    apart = gaps(
        [*found, *(r for r in rows if r["method"] == first.name)], row.method.name, first.name, found[0]["effort"]
    )
    return f"{np.mean(apart):+.2f}" if apart else ""


def _mean(rows: Sequence[dict], metric: str, form: str) -> str:
    found = means(rows, (metric,))
    return format(found[metric], form) if found else ""


def _spread(rows: Sequence[dict]) -> str:
    """Return the lowest and highest PSNR of the recordings, and the mean over scenes of the deviation over seeds."""
    levels = [row["psnr_db"] for row in rows]
    if len(levels) < 2:
        return ""
    by_scene = {scene: [r["psnr_db"] for r in rows if r["scene"] == scene] for scene in {r["scene"] for r in rows}}
    seeds = [float(np.std(some, ddof=1)) for some in by_scene.values() if len(some) > 1]
    over = f", ± {np.mean(seeds):.2f}" if seeds else ""
    return f"{min(levels):.1f} to {max(levels):.1f}{over}"


def _paper(table: Table, row: Row) -> str:
    return figures_of(PUBLISHED.get(table.name, PUBLISHED["novel-view"]).get(row.paper or "", {}))


def figures_of(figures: Figures) -> str:
    """Return published figures with their units; a dash where there are none."""
    return ", ".join(HOW[metric].format(value) for metric, value in figures.items()) or "-"


def _head(document: dict) -> str:
    rows = document["rows"]
    made = f"{machines_of(document, rows)}; {revisions_of(document, rows)}" if rows else "nothing has been run"
    return (
        f"# The paper's tables, as ours\n\nOurs: simulated scenes, the centre view held out, linear light; {made}. "
        f"Seconds are of the wall, from recording to last step; the clock stands "
        f"while a result is scored, and a run that warms up comes before.{_disturbed(rows)} "
        "The paper's figures were measured by its "
        "authors on other scenes and one RTX 4090: what may be compared is the order of the rows, not the numbers."
    )


def _disturbed(rows: Sequence[dict]) -> str:
    """Tell what other guests of the machine took from the runs that say so, and how fast it was beside them."""
    shares = [row["stolen"] for row in rows if "stolen" in row]
    if not shares:
        return ""
    took = f"{np.median(shares):.0%} of the processors' time in the median and {max(shares):.0%} in the worst"
    paces = [row["step_ms"] for row in rows if "step_ms" in row]
    pace = f" Beside {len(paces)} of them a fixed step took {min(paces):.0f} to {max(paces):.0f} ms." if paces else ""
    return f" Of {len(shares)} runs of {len(rows)} it is known what other guests of the machine took: {took}.{pace}"


def _scene_table(rows: Sequence[dict]) -> str:
    scores = (("psnr_db", ".2f"), ("dynamic_psnr_db", ".2f"), ("ssim", ".3f"), ("abs_rel", ".4f"), ("seconds", ".1f"))
    lines = [[r["scene"], r["model"], *(_mean([r], *score) for score in scores)] for r in rows]
    columns = ("scene", "model chosen", "PSNR / dB", "movers / dB", "SSIM", "Abs Rel", "seconds")
    return f"## Each stress scene (`scenes`)\n\nThe runs of the table `stress`.\n\n{markdown(columns, lines)}"
