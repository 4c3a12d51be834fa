"""Values that several commands take."""

import re

import click


class SizeType(click.ParamType):
    """WxH, as in 400x250."""

    name = "WxH"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, int]:
        if isinstance(value, tuple):
            return value
        found = re.fullmatch(r"(\d{1,4})x(\d{1,4})", str(value))
        if not found or not int(found[1]) or not int(found[2]):
            self.fail(f"found the size {value}, expected WIDTHxHEIGHT such as 400x250", param, ctx)
        return int(found[1]), int(found[2])


class PlanesType(click.ParamType):
    """A:B:STEP, planes from A up to but without B."""

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
