"""Writes EVIDENCE.md, the index of measurements, their tables and their diagrams anew: `make evidence`.

`EVIDENCE.md.in` and `benchmarks.md.in` beside this file are the texts. Each `{{NAME FIGURE FORMAT}}` in them becomes a
figure of `tests/benchmarks/NAME.json`: `revision`, `rows`, a name of the summary, or one `of_runs`. `FIGURE minus
FIGURE` stands for a difference. The tables of a document go into `NAME.md` beside it. The sheet of the training bench
needs its runs and is made by the bench itself.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from functools import partial
from pathlib import Path

import click
from maintenance.evidence_tables import page

from acquisition.durable import write_durably
from acquisition.scenes.looks import LOOKS, read_looks
from reconstruction.bench.diagrams import PLOTS
from reconstruction.bench.long.page import write_page as write_long_page
from reconstruction.bench.longer import write_page as write_longer_page
from reconstruction.bench.msdi import write_page as write_msdi_page
from reconstruction.bench.paper.diagrams import write_diagrams
from reconstruction.bench.paper.protocol import PROTOCOL
from reconstruction.bench.paper.summary import name_of
from reconstruction.bench.paper.tables import markdown, write_tables
from reconstruction.bench.rivals.bench import rivals_protocol
from reconstruction.bench.rivals.bench import write_page as write_rivals_page
from reconstruction.bench.score_run import METRICS
from reconstruction.bench.speed.page import write_page as write_speed_page
from reconstruction.bench.spss import write_page as write_spss_page
from reconstruction.bench.tuning import write_page as write_tuning_page
from reconstruction.bench.uncertainty.page import write_page as write_uncertainty_page
from reconstruction.errors import BadRunError
from reconstruction.networks.training.curve import plot_curves

ROOT = Path(__file__).resolve().parents[2]
BENCHMARKS = ROOT / "tests" / "benchmarks"
NETWORKS = ROOT / "reconstruction" / "networks"
WENT_ON = Path(__file__).with_name("msdi_went_on.json")  # from the weights of MSDI that ship, and what led to them
CLAIMS, INDEX = (Path(__file__).with_name(name) for name in ("EVIDENCE.md.in", "benchmarks.md.in"))
FIGURE = re.compile(r"\{\{([\w-]+) (\S+)(?: minus (\S+))?(?: (\S+))?\}\}")


def read_documents(folder: Path = BENCHMARKS) -> dict[str, dict]:
    """Return every document of the folder by its name."""
    return {file.stem: json.loads(file.read_text()) for file in sorted(folder.glob("*.json"))}


def filled(template: str, documents: Mapping[str, dict]) -> str:
    """Return the text with every figure put in; raises BadRunError for a figure that no document has."""

    known = {name: figures(name, document) for name, document in documents.items()}

    def value(name: str, key: str) -> float | str:
        if key not in known.get(name, {}):
            raise BadRunError(
                f"found the figure {key}", f"one of {name}.json", do="edit the text of EVIDENCE.md or of the index"
            )
        return known[name][key]

    def figure(found: re.Match[str]) -> str:
        name, key, less, form = found.groups()
        shown = value(name, key)
        if less:
            shown = float(shown) - float(value(name, less))
        return format(shown, form or "")

    return FIGURE.sub(figure, template)


def figures(name: str, document: dict) -> dict[str, float | str]:
    """Return every figure of a document by its name: the summary's, the revision, and those `of_runs`."""
    found = dict(document["summary"]) | {"revision": document["revision"], "rows": len(document["rows"])}
    return found | of_runs(document["rows"]) if name in ("paper", "rivals") else found


def of_runs(rows: list[dict]) -> dict[str, float]:
    """Return every score of every single run, its steps and its Gaussians, as `CELL.SCORE`."""
    scores = "steps", "gaussians", *METRICS
    return {f"{name_of(row)}.{score}": row[score] for row in rows for score in scores if score in row}


def hours(documents: Mapping[str, dict]) -> float:
    """Return the hours that the measured runs of all documents took, without scoring and simulation."""
    return sum(float(row.get("seconds") or 0) for d in documents.values() for row in d["rows"]) / 3600


LOOKS_ABOUT = """# Looks at evaluation scenes

Every run on a scene for evaluation or stress that a bench has kept, from [looks.jsonl](looks.jsonl). `spike4dgs bench`
adds to it. Those before it did are taken from the committed documents, on the day of their commit. Runs by hand are
called `profile`; those before 2026-11-28 are not in it."""
OWN_PAGES = {
    "long": write_long_page,
    "uncertainty": write_uncertainty_page,
    "spss": write_spss_page,
    "tuning": write_tuning_page,
    "longer": write_longer_page,
    "msdi": write_msdi_page,
    "rivals": partial(write_rivals_page, protocol=rivals_protocol()),
    **dict.fromkeys(("speed", "large"), write_speed_page),
}


def write_pages(folder: Path, documents: Mapping[str, dict]) -> None:
    """Write the tables of every document as NAME.md."""
    for name, document in documents.items():
        if name == "paper":
            write_tables(folder / "paper.md", document, PROTOCOL)
        elif name in OWN_PAGES:
            OWN_PAGES[name](folder / f"{name}.md", document)
        else:
            write_durably(folder / f"{name}.md", page(name, document).encode())


def looks_page(looks: Iterable[dict]) -> str:
    """Return the page of all looks at evaluation scenes, those of one day, bench and revision in a line."""
    lines: dict[tuple[str, ...], list[str]] = {}
    for look in sorted(looks, key=lambda one: one["day"]):
        key = look["day"], look["bench"], look["revision"], look["reason"]
        lines.setdefault(key, []).append(f"{look['scene']} {look['runs']}")
    rows = [(day, bench, revision, ", ".join(seen), reason) for (day, bench, revision, reason), seen in lines.items()]
    return f"{LOOKS_ABOUT}\n\n{markdown(('day', 'bench', 'revision', 'runs on', 'reason'), rows)}\n"


@click.command()
@click.option("--folder", type=click.Path(path_type=Path), default=BENCHMARKS, show_default=True)
@click.option("--text", type=click.Path(path_type=Path), default=ROOT / "EVIDENCE.md", show_default=True)
def main(folder: Path, text: Path) -> None:
    """Draw every figure and fill every table anew, and say how long the runs behind them took."""
    documents = read_documents(folder)
    for name, plot in PLOTS.items():
        if name in documents:
            plot(folder / f"{name}.png", documents[name])
    if "paper" in documents:
        write_diagrams(folder, documents["paper"])
    write_pages(folder, documents)
    write_durably(folder / "looks.md", looks_page(read_looks(folder / LOOKS)).encode())
    plot_curves([NETWORKS / "weights" / name for name in ("small.json", "blindspot.json")], folder / "learned.png")
    plot_curves([WENT_ON], folder / "msdi.png")
    for target, template in ((text, CLAIMS), (folder / "README.md", INDEX)):
        write_durably(target, filled(template.read_text(), documents).encode())
    protocol = sum(cell.effort.budget_s or 0.0 for cell in PROTOCOL.cells()) / 3600
    whole = hours({name: found for name, found in documents.items() if name != "paper"}) + protocol
    click.echo(f"{text} stands on {hours(documents):.1f} hours of measured runs; all of `make bench` is {whole:.0f}")


if __name__ == "__main__":
    main()
