"""Options and values that several commands take."""

import re
from pathlib import Path

import click

from rigs.rig import Rig
from rigs.toml import catalog_names, catalog_rig, load_rig

PATH = click.Path(path_type=Path)
json_option = click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
new_recording = click.option("--out", type=PATH, required=True, help="The recording to make; a new folder.")
data_folder = click.option("--data", type=PATH, help="Data folder.  [default: .spike4dgs]")


class SizeType(click.ParamType):
    """A size WxH, such as 400x250."""

    name = "WxH"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, int]:
        if isinstance(value, tuple):
            return value
        found = re.fullmatch(r"(\d{1,4})x(\d{1,4})", str(value))
        if not found or not int(found[1]) or not int(found[2]):
            self.fail(f"found the size {value}, expected WIDTHxHEIGHT such as 400x250", param, ctx)
        return int(found[1]), int(found[2])


class PlanesType(click.ParamType):
    """Planes A:B:STEP, from A up to but without B."""

    name = "A:B:STEP"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> range:
        if isinstance(value, range):
            return value
        found = re.fullmatch(r"(\d+):(\d+)(?::(\d+))?", str(value))
        chosen = range(int(found[1]), int(found[2]), max(1, int(found[3] or 1))) if found else range(0)
        if not chosen:
            self.fail(f"found {value!r}, expected A:B:STEP with A < B, for example 100:200:20", param, ctx)
        return chosen


SIZE = SizeType()
PLANES = PlanesType()


def load_named_rig(name: str) -> Rig:
    """Return the rig of the file `name` or, if there is no such file, the rig of the catalog with that name."""
    return catalog_rig(name) if name in catalog_names() and not Path(name).exists() else load_rig(Path(name))
