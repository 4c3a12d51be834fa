"""`stability`: the stress catalogue, as a table or one JSON document."""

import json
import sys

import click

from server.cli.progress import progress_of


@click.command("stability")
@click.option("--json", "as_json", is_flag=True, help="Print the document as JSON.")
def stability_command(as_json: bool) -> None:
    """Run the stress catalogue: what was expected of each backend and what was seen. Exit 1 where a case failed."""
    from reconstruction.stability.catalogue import run_catalogue  # a capture host has no torch

    document = run_catalogue(progress_of("stability"))
    click.echo(json.dumps(document) if as_json else _table(document))
    sys.exit(1 if document["summary"]["failed"] else 0)


def _table(document: dict) -> str:
    columns = ("case", "backend", "expected", "observed", "verdict")
    cells = [columns, *(tuple(str(row[c]) for c in columns) for row in document["rows"])]
    widths = [max(len(row[i]) for row in cells) for i in range(len(columns))]
    lines = ["  ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)).rstrip() for row in cells]
    summary = "{cases} cases, {failed} failed".format(**document["summary"])
    return "\n".join([*lines, summary, *(f"left out: {o}" for o in document["omissions"])])
