"""`stability`: the stress catalogue, as a table or one JSON document."""

import sys
from pathlib import Path

import click

from acquisition.durable import write_json
from reconstruction.bench.diagrams import plot_stability
from reconstruction.stability.catalogue import LongRuns, run_catalogue
from server.cli.options import json_option
from server.cli.output import answer, columns
from server.cli.progress import progress_of

_SHOWN = ("case", "backend", "expected", "observed", "error", "gradient", "verdict")


@click.command("stability")
@json_option
@click.option("--full", is_flag=True, help="Also ten million ticks, and trainings on the stiff scenes: minutes.")
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), help="Keep stability.json here, and a plot.")
def stability_command(as_json: bool, full: bool, out: Path | None) -> None:
    """Run the stress catalogue on each backend; print what was expected and what was seen. Exit 1 if a case failed."""
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
    document = run_catalogue(progress_of("stability"), LongRuns() if full else None)
    if out is not None:
        write_json(out / "stability.json", document)
        if "curves" in document:
            plot_stability(out / "stability.png", document)
    cells = [_SHOWN, *(tuple(_cell(row[c]) for c in _SHOWN) for row in document["rows"])]
    summary = "{cases} cases, {failed} failed".format(**document["summary"])
    lines = [columns(cells), summary, *(f"left out: {o}" for o in document["omissions"])]
    answer(document, "\n".join(lines), as_json=as_json)
    sys.exit(1 if document["summary"]["failed"] else 0)


def _cell(value: str | float | None) -> str:
    if value is None:
        return ""
    return value if isinstance(value, str) else f"{value:.1e}"
