"""`token`: who may use a service that others reach."""

from contextlib import closing
from pathlib import Path
from typing import get_args

import click

from server.cli.options import data_folder, json_option
from server.cli.output import answer, columns
from server.cli.serve import parse_name
from server.settings import settings_of
from server.store.store import Store
from server.store.tables import Role


@click.group()
def token_command() -> None:
    """Decide who may use the service. From the first token on, every request needs one."""


@token_command.command("add")
@click.argument("name", type=parse_name)
@click.option("--role", type=click.Choice(get_args(Role)), required=True, help="A viewer reads, an operator does all.")
@data_folder
def add_command(name: str, role: Role, data: Path | None) -> None:
    """Make a token and print it. It is shown only now: the service keeps a digest."""
    with _store(data) as store:
        click.echo(store.tokens.add(name, role))


@token_command.command("list")
@data_folder
@json_option
def list_command(data: Path | None, as_json: bool) -> None:
    """List the tokens' names and roles."""
    with _store(data) as store:
        found = [{"name": one.name, "role": one.role, "created": one.created} for one in store.tokens.all()]
    lines = columns([tuple(one.values()) for one in found]) if found else "no tokens: only this machine is answered"
    answer(found, lines, as_json=as_json)


@token_command.command("remove")
@click.argument("name", type=parse_name)
@data_folder
def remove_command(name: str, data: Path | None) -> None:
    """Revoke a token; the service refuses it within two seconds."""
    with _store(data) as store:
        store.tokens.remove(name)
        if not store.tokens.all():
            click.echo("that was the last: the service is open on this machine, and closed to all others", err=True)


def _store(data: Path | None) -> closing[Store]:
    return closing(Store(settings_of(rig=None, devices=None, data=data)))
