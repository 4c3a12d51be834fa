"""The leave-out bench as a picture: each case by its plan and with everything on, and what was claimed of decisions."""

import io
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from acquisition.durable import write_durably

PANELS = (
    ("cpu_s", "processor seconds", False),
    ("peak_mb", "peak memory / MB", False),
    ("psnr_db", "PSNR / dB", False),
    ("psnr_db", "PSNR at equal time / dB", True),
)


def plot_leave_out(path: Path, document: dict) -> None:
    """A line a case from its plan to everything on; below them, saved against claimed seconds of single decisions."""
    figure = Figure(figsize=(11, 6.4), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(2, len(PANELS))
    panels = [figure.add_subplot(grid[0, i]) for i in range(len(PANELS))]
    rows = [r for r in document["rows"] if r["decision"] == "all" and "refused" not in r]
    cases = list(dict.fromkeys(r["case"] for r in rows))
    for axes, (key, label, timed) in zip(panels, PANELS, strict=True):
        _draw_pairs(axes, [r for r in rows if r["extent"].endswith("s") == timed], cases, key)
        axes.set_xlabel(label)
    for i, axes in enumerate(panels):
        axes.set_yticks(range(len(cases)), ["" if i else case for case in cases], fontsize=8)
        axes.invert_yaxis()
    panels[0].legend(fontsize=7)
    _draw_claims(figure.add_subplot(grid[1, :]), document["summary"])
    device = document["device"]
    figure.suptitle(f"{device['processor']}, {device['threads']} threads; revision {document['revision']}", fontsize=8)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110)
    write_durably(path, buffer.getvalue())


def _draw_pairs(axes: Axes, rows: list[dict], cases: list[str], key: str) -> None:
    """Dots of `plan` and `all`, joined, a line a case."""
    for y, case in enumerate(cases):
        found = {r["run"]: r[key] for r in rows if r["case"] == case}
        axes.plot(list(found.values()), [y] * len(found), "-", color="#bbb", zorder=1)
    for run, colour in (("plan", "C0"), ("all", "C1")):
        some = [r for r in rows if r["run"] == run]
        axes.plot([r[key] for r in some], [cases.index(r["case"]) for r in some], "o", color=colour, label=run)
    axes.grid(True, axis="x", alpha=0.3)


def _draw_claims(axes: Axes, summary: dict[str, float]) -> None:
    """Bars of what each decision saved, beside what the plan claimed."""
    names = [key.removesuffix(".claimed_s") for key in summary if key.endswith(".claimed_s")]
    names = [name for name in names if f"{name}.saved_s" in summary]
    for shift, what, colour in ((-0.2, "claimed", "#999"), (0.2, "saved", "C2")):
        places = [i + shift for i in range(len(names))]
        axes.bar(places, [summary[f"{name}.{what}_s"] for name in names], 0.4, color=colour, label=what)
    axes.set_xticks(range(len(names)), names, fontsize=8, rotation=20, ha="right")
    axes.set_ylabel("processor seconds")
    axes.grid(True, axis="y", alpha=0.3)
    if names:
        axes.legend(fontsize=7)
