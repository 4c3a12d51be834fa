"""`spike4dgs token`: who may use a service that others reach."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from server.cli.serve import NAME

if TYPE_CHECKING:
    from server.store.tokens import Tokens

ROLES = ("viewer", "operator")


def _data_option(command: Callable[..., None]) -> Callable[..., None]:
    return click.option("--data", type=click.Path(path_type=Path), help="Data folder.  [default: .spike4dgs]")(command)


@click.group()
def token_command() -> None:
    """Say who may use the service. As soon as there is one token, every request needs one."""


@token_command.command("add")
@click.argument("name", type=NAME)
@click.option("--role", type=click.Choice(ROLES), required=True, help="A viewer reads, an operator does everything.")
@_data_option
def add_command(name: str, role: str, data: Path | None) -> None:
    """Make a token and print it, once: only a digest is kept."""
    with _tokens(data) as tokens:
        click.echo(tokens.add(name, "operator" if role == "operator" else "viewer"))


@token_command.command("list")
@_data_option
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
def list_command(data: Path | None, as_json: bool) -> None:
    """List the tokens' names and roles."""
    with _tokens(data) as tokens:
        found = [{"name": one.name, "role": one.role, "created": one.created} for one in tokens.all()]
    lines = [f"{one['name']:<24} {one['role']:<10} {one['created']}" for one in found]
    click.echo(
        json.dumps(found) if as_json else "\n".join(lines or ["no tokens: the service answers this machine only"])
    )


@token_command.command("remove")
@click.argument("name", type=NAME)
@_data_option
def remove_command(name: str, data: Path | None) -> None:
    """Make a token worthless, within two seconds."""
    with _tokens(data) as tokens:
        tokens.remove(name)
        if not tokens.all():
            click.echo("that was the last: the service is open on this machine, and closed to all others", err=True)


@contextmanager
def _tokens(data: Path | None) -> Iterator[Tokens]:
    from server.settings import settings_of
    from server.store.store import Store

    store = Store.open(settings_of(rig=None, devices=None, data=data))
    try:
        yield store.tokens
    finally:
        store.close()
