"""Writes the page and the picture of the bench of long recordings: error along them, seconds, memory, bytes."""

from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes

from acquisition.bench_document import SPAN, machines_of, revisions_of
from acquisition.durable import write_durably
from acquisition.scenes.looks import EVALUATED
from reconstruction.bench.conventions import made_by
from reconstruction.bench.figures import COLOURS, caption, name_axes, new_figure, write_figure
from reconstruction.bench.long.bench import ALONE, BASELINE, FLOORS, WHOLE
from reconstruction.bench.paper.tables import markdown

ABOUT = """The whole is one reconstruction in spans. A part alone is the same planes as a recording of their own.
Since decision 189 the whole has twice as many still Gaussians as a part. A baseline has the whole in one piece, as many
seconds, and fewer Gaussians, which it shares out over all planes; `4dgs-small` is smaller than published. Every run is
a process of its own. Seconds are wall seconds from the start of the process to the end of the report; those of a span
are of its training alone, and those of spans that were joined are shared out. Bytes are those of the stored scene."""
ALIKE = "A span is scored on as many instants as the part alone."
UNLIKE = "A span was scored on 4 instants at most, a part alone on 8, so that ends weigh more in spans."
RUNS = (
    ("planes", "planes", ",.0f"),
    ("budget_s", "budget / s", ".0f"),
    ("psnr_db", "PSNR / dB", ".2f"),
    ("dynamic_psnr_db", "movers / dB", ".2f"),
    ("abs_rel", "Abs Rel", ".4f"),
    ("wall_s", "seconds", ".1f"),
    ("steps", "steps", ",.0f"),
    ("gaussians", "Gaussians", ",.0f"),
    ("peak_mb", "memory / MB", ",.0f"),
    ("stored_bytes", "bytes", ",.0f"),
    ("stolen", "stolen", ".3f"),
)
SPANS = (
    ("first_tick", "first plane", ".0f"),
    ("last_tick", "last plane", ".0f"),
    ("psnr_db", "PSNR / dB", ".2f"),
    ("dynamic_psnr_db", "movers / dB", ".2f"),
    ("abs_rel", "Abs Rel", ".4f"),
    ("seconds", "seconds", ".1f"),
)
RATIOS = {
    "psnr_db": "PSNR of the whole less that of its parts / dB",
    "dynamic_psnr_db": "the same of movers / dB",
    "abs_rel": "the same of the depth error",
    "seconds_ratio": "seconds a plane, over those of the parts",
    "memory_ratio": "peak memory, over that of the parts",
    "bytes_ratio": "bytes a plane, over those of the parts",
    "seam_ratio": "step of movers' errors at seams, over that within spans",
    "followed": "bodies that were followed across a seam",
    "switched": "of these, other objects after it",
    "above_best.psnr_db": "PSNR above the best baseline in one piece / dB",
}
KINDS = {WHOLE: "in spans", ALONE: "a part alone", BASELINE: "a baseline in one piece"}
BY_LENGTH = (  # of the runs: the name of a value, what the axis calls it, its unit, whether it is of a plane
    ("wall_s", "seconds a plane", 1, True),
    ("peak_mb", "memory / MB", 1, False),
    ("stored_bytes", "kB of the scene a plane", 1e3, True),
)
LINES = (("psnr_db", "whole picture", COLOURS[0]), ("dynamic_psnr_db", "movers", COLOURS[1]))


def write_page(path: Path, document: dict) -> None:
    """Write the page of a document of the bench of long recordings."""
    write_durably(path, page(document).encode())


def page(document: dict) -> str:
    """Return the page of a document of the bench of long recordings."""
    parts = ["# Long recordings", made_by(document), ABOUT.replace("\n", " ")]
    for clip in dict.fromkeys(row["clip"] for row in document["rows"]):
        own = [row for row in document["rows"] if row["clip"] == clip]
        runs = [row for row in own if row["part"] != SPAN]
        alike = all("instants" in row for row in own if row["part"] == SPAN)
        made = f"{revisions_of(document, runs).capitalize()}, {machines_of(document, runs)}."
        about = f"{_use(runs[0]['scene'])} {made} {ALIKE if alike else UNLIKE}"
        parts += [f"## {clip}", about, _table("run", RUNS, [(_name(row), row) for row in runs])]
        floor = [row for row in runs if row["part"] == WHOLE and all(name in row for name in FLOORS)]
        parts += [_floor(*(row[name] for name in FLOORS)) for row in floor]
        ratios = {name: document["summary"].get(f"{clip}.{key}") for key, name in RATIOS.items()}
        lines = [(name, f"{value:.3f}".removesuffix(".000")) for name, value in ratios.items() if value is not None]
        parts += [markdown(("compared", ""), lines)] if lines else []
        spans = [row for row in own if row["part"] == SPAN]
        parts += [_table("span", SPANS, [(str(row["number"]), row) for row in spans])] if spans else []
    if document["omissions"]:
        parts += ["## Omissions", "\n".join(f"- {line}" for line in document["omissions"])]
    return "\n\n".join(parts) + "\n"


def plot_long(path: Path, document: dict) -> None:
    """Draw the error along each recording, in spans and in parts alone; a document without spans has no picture."""
    rows = document["rows"]
    clips = list(dict.fromkeys(row["clip"] for row in rows if row["part"] == SPAN))
    if not clips:
        return
    figure = new_figure("Long recordings", (8.6, 3.2 + 3.4 * len(clips)))
    grid = figure.add_gridspec(len(clips) + 1, len(BY_LENGTH))
    _plot_lengths([figure.add_subplot(grid[-1, i]) for i in range(len(BY_LENGTH))], rows)
    for place, clip in enumerate(clips):
        axes = figure.add_subplot(grid[place, :])
        spans = [row for row in rows if row["clip"] == clip and row["part"] == SPAN]
        alone = [row for row in rows if row["clip"] == clip and row["part"] == ALONE]
        for score, name, colour in LINES:
            axes.plot(
                [(row["first_tick"] + row["last_tick"]) / 2 for row in spans if score in row],
                [row[score] for row in spans if score in row],
                "o-",
                color=colour,
                label=f"{name}, in spans",
            )
            middles = [(row["first_tick"] + row["last_tick"]) / 2 for row in alone]
            found = [row[score] for row in alone]
            axes.plot(middles, found, "s", color=colour, fillstyle="none", label=f"{name}, the part alone")
        axes.set_title(clip, fontsize=10, loc="left")
        name_axes(axes, "plane", "PSNR of the held-out view / dB")
        axes.legend(fontsize=7, frameon=False, ncols=4, columnspacing=1, loc="lower right", bbox_to_anchor=(1, 0.98))
    told = "A mark is the mean over the instants of a span that have truth."
    write_figure(path, figure, caption(document, rows, told))


def _plot_lengths(panels: Sequence[Axes], rows: Sequence[dict]) -> None:
    """Draw what a plane costs, and the memory, against the length of a recording; parts alone are the shortest."""
    for axes, (key, name, scale, a_plane) in zip(panels, BY_LENGTH, strict=True):
        for part, mark, colour in ((WHOLE, "o-", COLOURS[0]), (ALONE, "s", COLOURS[2]), (BASELINE, "x", COLOURS[3])):
            own = sorted((row for row in rows if row["part"] == part), key=lambda row: row["planes"])
            values = [row[key] / scale / (row["planes"] if a_plane else 1) for row in own]
            axes.plot([row["planes"] for row in own], values, mark, color=colour, label=KINDS[part])
        axes.set_xscale("log")
        axes.set_ylim(bottom=0)
        name_axes(axes, "planes", name)
    panels[0].legend(fontsize=7, frameon=False)


def _use(scene: str) -> str:
    return "An evaluation scene." if scene in EVALUATED else "A development scene."


def _floor(whole_db: float, movers_db: float) -> str:
    """Return what a blend of the cameras' own pictures, warped by depth, has on the whole recording."""
    return f"The depth-warped blend of the training cameras' pictures has {whole_db:.2f} dB, movers {movers_db:.2f}."


def _name(row: dict) -> str:
    if row["part"] == BASELINE:
        return f"`{row['model']}` in one piece"
    return "in spans" if row["part"] == WHOLE else f"part {row['number']} alone"


def _table(first: str, forms: tuple[tuple[str, str, str], ...], rows: list[tuple[str, dict]]) -> str:
    lines = [[name, *(format(row[key], form) if key in row else "" for key, _, form in forms)] for name, row in rows]
    return markdown((first, *(label for _, label, _ in forms)), lines)
