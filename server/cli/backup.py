"""`backup` copies what a service knows, `restore` puts it back."""

from pathlib import Path

import click

from server.cli.options import PATH, data_folder
from server.settings import settings_of
from server.store.backup import back_up, restore


@click.command()
@click.option("--out", type=PATH, required=True, help="The backup to make; a new folder.")
@data_folder
def backup_command(out: Path, data: Path | None) -> None:
    """Copy databases, calibrations and logs of a data folder, while its service runs.

    Recordings, uploads and results are files under their own names: copy them with a tool for files.
    """
    back_up(settings_of(rig=None, devices=None, data=data), out)


@click.command()
@click.argument("backup", type=PATH)
@data_folder
def restore_command(backup: Path, data: Path | None) -> None:
    """Put a backup into a data folder, whose service and workers are stopped. The databases there are moved aside."""
    replaced, orphans = restore(backup, settings_of(rig=None, devices=None, data=data))
    if replaced is not None:
        click.echo(f"the databases that were there are in {replaced}")
    for kind, names in orphans._asdict().items():
        if names:
            click.echo(f"{len(names)} {kind} are newer than the backup and have no entry: {', '.join(names)}")
