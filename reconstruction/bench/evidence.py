"""EVIDENCE.md and its figures, made again from the committed documents: `make evidence`.

A section that links `tests/benchmarks/NAME.json` has lines of figures, each a name of that document's summary, and
blocks between `<!-- begin NAME BLOCK -->` and `<!-- end -->`. Both are filled in place; the sentences around them are
written by people. Pictures of runs (sheets, videos) need the runs and are made by the benches themselves.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from pathlib import Path

import click

from acquisition.durable import write_durably
from reconstruction.bench.evidence_tables import table
from reconstruction.bench.paper.diagrams import write_diagrams
from reconstruction.bench.paper.others import open_others
from reconstruction.bench.paper.protocol import PROTOCOL
from reconstruction.bench.paper.tables import write_tables
from reconstruction.bench.plot import plot_training
from reconstruction.bench.plot_images import plot_images
from reconstruction.bench.plot_leave_out import plot_leave_out
from reconstruction.bench.plot_poses import plot_poses
from reconstruction.bench.plot_viewpoints import plot_viewpoints
from reconstruction.errors import BadRunError
from reconstruction.networks.training.curve import plot_curves as plot_learned
from reconstruction.networks.training.msdi_curve import plot_curves as plot_msdi

LINK = re.compile(r"\(tests/benchmarks/([\w-]+)\.json\)")
FIGURE = re.compile(r"^\| `([^`]+)` \| ([-+.\deE]+) \|$", re.MULTILINE)
BLOCK = re.compile(r"(<!-- begin ([\w-]+) ([\w-]+) -->\n).*?(<!-- end -->)", re.DOTALL)
Plot = Callable[[Path, dict], None]
PLOTS: Mapping[str, Plot] = {
    "training": plot_training,
    "images": plot_images,
    "poses": plot_poses,
    "viewpoints": plot_viewpoints,
    "leave-out": plot_leave_out,
}
IMAGE_NETWORKS = ("small.json", "blindspot.json")


def figures_filled(text: str, documents: Mapping[str, dict]) -> str:
    """The text with every figure, and every block's table, as the documents have it; BadRunError for others."""
    sections = text.split("\n## ")
    return "\n## ".join(_section_filled(section, documents) for section in sections)


def _section_filled(section: str, documents: Mapping[str, dict]) -> str:
    """Figures from the first document the section links, blocks from the one each names."""
    linked = next((name for name in LINK.findall(section) if name in documents), None)
    summary = documents[linked]["summary"] if linked else {}

    def figure(found: re.Match[str]) -> str:
        name, digits = found[1], len(found[2].partition(".")[2])
        if name not in summary:
            raise BadRunError(
                f"found the figure {name}", f"a name of the summary of {linked}.json", where="EVIDENCE.md"
            )
        return f"| `{name}` | {summary[name]:.{digits}f} |"

    def block(found: re.Match[str]) -> str:
        return f"{found[1]}{table(documents, found[2], found[3])}\n{found[4]}"

    return BLOCK.sub(block, FIGURE.sub(figure, section))


def read_documents(folder: Path) -> dict[str, dict]:
    """Every document of the folder by its name."""
    return {file.stem: json.loads(file.read_text()) for file in sorted(folder.glob("*.json"))}


def hours(documents: Mapping[str, dict]) -> float:
    """What the measured runs of all documents took, scoring and simulation left out."""
    return sum(float(row.get("seconds") or 0) for d in documents.values() for row in d["rows"]) / 3600


@click.command()
@click.option("--folder", type=click.Path(path_type=Path), default="tests/benchmarks", show_default=True)
@click.option("--text", type=click.Path(path_type=Path), default="EVIDENCE.md", show_default=True)
def main(folder: Path, text: Path) -> None:
    """Draw every figure and fill every table anew, and say how long the runs behind them took."""
    documents = read_documents(folder)
    for name, plot in PLOTS.items():
        if name in documents:
            plot(folder / f"{name}.png", documents[name])
    if "paper" in documents:
        others = open_others(folder)
        write_tables(folder / "paper.md", documents["paper"], PROTOCOL, others)
        write_diagrams(folder, documents["paper"], others)
    weights = Path("reconstruction") / "networks" / "weights"
    plot_learned([weights / name for name in IMAGE_NETWORKS], folder / "learned.png")
    plot_msdi([Path("reconstruction") / "networks" / "msdi" / "weights" / "small.json"], folder / "msdi.png")
    filled = figures_filled(text.read_text(), documents)
    write_durably(text, filled.encode())
    whole = hours({name: found for name, found in documents.items() if name != "paper"}) + PROTOCOL.hours
    click.echo(f"{text} stands on {hours(documents):.1f} hours of measured runs; all of `make bench` is {whole:.0f}")


if __name__ == "__main__":
    main()
