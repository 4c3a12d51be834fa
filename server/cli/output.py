"""Prints answers on standard output: one JSON document, or text in columns."""

import json
from collections.abc import Sequence

import click


def answer(document: object, text: str, *, as_json: bool) -> None:
    """Print `document` as JSON, or else `text`."""
    click.echo(json.dumps(document) if as_json else text)


def warn(doubt: str) -> None:
    """Print a doubt on standard error."""
    click.echo(f"warning: {doubt}", err=True)


def columns(rows: Sequence[Sequence[str]], *, numbers: bool = False) -> str:
    """Return rows of cells as lines with aligned columns; `numbers` aligns all but the first column to the right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]

    def cell(text: str, number: int) -> str:
        return text.rjust(widths[number]) if numbers and number else text.ljust(widths[number])

    return "\n".join("  ".join(cell(text, number) for number, text in enumerate(row)).rstrip() for row in rows)


def scores(metrics: dict[str, object]) -> str:
    """Return a line for each score of a run, and one for each of its spans."""
    return "\n".join(line for name, value in metrics.items() for line in _lines(name, value))


def _lines(name: str, value: object) -> list[str]:
    if isinstance(value, list):
        rows = (", ".join(line for key, score in row.items() for line in _lines(key, score)) for row in value)
        return [f"{name} {number}: {row}" for number, row in enumerate(rows)]
    return [f"{name}: {value:.4f}" if isinstance(value, float) else f"{name}: {value}"]
