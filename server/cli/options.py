"""Options and values that several commands take."""

import dataclasses
import functools
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from rigs.rig import Rig
from rigs.toml import catalog_names, catalog_rig, load_rig

PATH = click.Path(path_type=Path)
json_option = click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
new_recording = click.option("--out", type=PATH, required=True, help="The recording to make; a new folder.")
from_tick = click.option("--from-tick", type=int, metavar="A", help="First tick of a part [default: the first].")
to_tick = click.option("--to-tick", type=int, metavar="B", help="Tick after the last of a part [default: the end].")
data_folder = click.option("--data", type=PATH, help="Data folder.  [default: .spike4dgs]")


def several(*options: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Return a decorator that adds all `options` to a command, in this order."""
    return lambda command: functools.reduce(lambda made, option: option(made), reversed(options), command)


def keep_free(megabytes: int) -> Callable[[Any], Any]:
    """Return the option, `megabytes` by default, for the bytes of the disk that a recording leaves free."""
    return click.option(
        "--keep-free",
        "keep_free_bytes",
        default=megabytes,
        show_default=True,
        type=click.IntRange(min=0),
        callback=lambda context, parameter, value: value * 1_000_000,
        help="MB of the disk to leave free.",
    )


def numbers_of(kind: type) -> Callable[[Any], Any]:
    """Return the options for the numbers of a dataclass whose fields say `most` and `about` in their metadata."""
    return several(
        *(
            click.option(
                f"--{field.name.replace('_', '-')}",
                default=field.default,
                show_default=True,
                type=click.FloatRange(0, field.metadata["most"]),
                help=field.metadata["about"],
            )
            for field in dataclasses.fields(kind)
            if field.metadata
        )
    )


def parse_size(text: str) -> tuple[int, int]:
    """Return width and height from the text WIDTHxHEIGHT."""
    found = re.fullmatch(r"(\d{1,4})x(\d{1,4})", text)
    if not found or not int(found[1]) or not int(found[2]):
        raise click.BadParameter(f"found the size {text}, expected WIDTHxHEIGHT such as 400x250")
    return int(found[1]), int(found[2])


def parse_planes(text: str) -> range:
    """Return the planes that the text A:B:STEP names."""
    found = re.fullmatch(r"(\d+):(\d+)(?::(\d+))?", text)
    chosen = range(int(found[1]), int(found[2]), max(1, int(found[3] or 1))) if found else range(0)
    if not chosen:
        raise click.BadParameter(f"found {text!r}, expected A:B:STEP with A < B, for example 100:200:20")
    return chosen


def load_named_rig(name: str) -> Rig:
    """Return the rig of the file `name` or, if there is no such file, the rig of the catalog with that name."""
    return catalog_rig(name) if name in catalog_names() and not Path(name).exists() else load_rig(Path(name))
