"""Options and values that several commands take."""

import re
from collections.abc import Callable
from pathlib import Path

import click

from rigs.rig import Rig
from rigs.toml import catalog_names, catalog_rig, load_rig

PATH = click.Path(path_type=Path)
json_option = click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
new_recording = click.option("--out", type=PATH, required=True, help="The recording to make; a new folder.")
data_folder = click.option("--data", type=PATH, help="Data folder.  [default: .spike4dgs]")


class Parsed(click.types.FuncParamType):
    """A value that a function reads from text; the help shows it as `name`."""

    def __init__(self, name: str, read: Callable[[str], object]) -> None:
        super().__init__(read)
        self.name = name


def _size(text: str) -> tuple[int, int]:
    found = re.fullmatch(r"(\d{1,4})x(\d{1,4})", text)
    if not found or not int(found[1]) or not int(found[2]):
        raise click.BadParameter(f"found the size {text}, expected WIDTHxHEIGHT such as 400x250")
    return int(found[1]), int(found[2])


def _planes(text: str) -> range:
    found = re.fullmatch(r"(\d+):(\d+)(?::(\d+))?", text)
    chosen = range(int(found[1]), int(found[2]), max(1, int(found[3] or 1))) if found else range(0)
    if not chosen:
        raise click.BadParameter(f"found {text!r}, expected A:B:STEP with A < B, for example 100:200:20")
    return chosen


SIZE = Parsed("WxH", _size)
PLANES = Parsed("A:B:STEP", _planes)


def load_named_rig(name: str) -> Rig:
    """Return the rig of the file `name` or, if there is no such file, the rig of the catalog with that name."""
    return catalog_rig(name) if name in catalog_names() and not Path(name).exists() else load_rig(Path(name))
