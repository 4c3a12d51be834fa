"""`stability`: the stress catalogue, as a table or one JSON document."""

import json
import sys
from pathlib import Path

import click

from server.cli.progress import progress_of


@click.command("stability")
@click.option("--json", "as_json", is_flag=True, help="Print the document as JSON.")
@click.option("--full", is_flag=True, help="Also ten million ticks, and trainings on the stiff scenes: minutes.")
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), help="Keep stability.json here, and a plot.")
def stability_command(as_json: bool, full: bool, out: Path | None) -> None:
    """Run the stress catalogue: what was expected of each backend and what was seen. Exit 1 where a case failed."""
    from reconstruction.stability.catalogue import LongRuns, run_catalogue  # a capture host has no torch

    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
    document = run_catalogue(progress_of("stability"), LongRuns() if full else None)
    if out is not None:
        _keep(out, document)
    click.echo(json.dumps(document) if as_json else _table(document))
    sys.exit(1 if document["summary"]["failed"] else 0)


def _keep(folder: Path, document: dict) -> None:
    from acquisition.durable import write_json
    from reconstruction.stability.plot import plot_stability

    write_json(folder / "stability.json", document)
    if "curves" in document:
        plot_stability(folder / "stability.png", document)


def _table(document: dict) -> str:
    columns = ("case", "backend", "expected", "observed", "error", "gradient", "verdict")
    cells = [columns, *(tuple(_cell(row[c]) for c in columns) for row in document["rows"])]
    widths = [max(len(row[i]) for row in cells) for i in range(len(columns))]
    lines = ["  ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)).rstrip() for row in cells]
    summary = "{cases} cases, {failed} failed".format(**document["summary"])
    return "\n".join([*lines, summary, *(f"left out: {o}" for o in document["omissions"])])


def _cell(value: str | float | None) -> str:
    if value is None:
        return ""
    return value if isinstance(value, str) else f"{value:.1e}"
