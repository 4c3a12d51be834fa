"""The names a request may choose from, each list taken from where it is defined."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

from pydantic import GetCoreSchemaHandler
from pydantic_core import CoreSchema, core_schema

from reconstruction.export.catalogue import FORMATS
from reconstruction.images.catalogue import GIVEN
from reconstruction.run.configuration import CHOICES, STAGES

# These read files of the user or are for benchmarks alone.
_COMMAND_LINE_ONLY = (*GIVEN, "interpolated", "dust3r")


@dataclass(frozen=True)
class OneOf:
    """Makes pydantic accept one of `names` and list them in the schema, as it does for a Literal."""

    names: Sequence[str]

    def __get_pydantic_core_schema__(self, source: object, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Return the schema of a Literal of the names."""
        return core_schema.literal_schema(list(self.names))


def _names(field: str) -> tuple[str, ...]:
    return tuple(name for name in CHOICES[field] if name not in _COMMAND_LINE_ONLY)


Model = Annotated[str, OneOf(_names("model"))]
Images = Annotated[str, OneOf(_names("images"))]
ImageMethod = Annotated[str, OneOf([name for name in _names("images") if name != "auto"])]
Init = Annotated[str, OneOf(_names("init"))]
Supervision = Annotated[str, OneOf(_names("supervision"))]
Refine = Annotated[str, OneOf(_names("refine"))]
Stage = Annotated[str, OneOf(STAGES)]
ExportFormat = Annotated[str, OneOf([name for name, form in FORMATS.items() if form.served])]
