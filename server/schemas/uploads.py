"""Files that clients send, piece by piece."""

from typing import Annotated, Literal

from pydantic import BaseModel, Field

from acquisition.recording.importing import SourceFormat
from acquisition.spikes.layout import BitOrder, RowOrder
from server.schemas.captures import Name
from server.schemas.progress import Page, Request

Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$", description="In 64 small hexadecimal digits.")]


class UploadRequest(Request):
    """A file to be sent; `name` is a label for people and never a path, `sha256` is checked at the end."""

    name: Name
    bytes: Annotated[int, Field(ge=1, lt=2**63)]
    sha256: Sha256 | None = None


class Upload(BaseModel):
    """A file that was or is being sent; `offset` bytes have come, and the next ones begin there."""

    id: str
    created: str
    name: str
    bytes: int
    offset: int
    sha256: str | None
    state: Literal["open", "committed"]


class Uploads(Page[Upload]):
    """Uploads, newest first; `next` is the cursor of the next page."""


class LayoutAsked(BaseModel):
    """A layout to read an upload in; m1k40 fixes all of it, the others need `width` and `height`."""

    format: SourceFormat = "vidar"
    width: Annotated[int | None, Field(ge=1, le=9999)] = None
    height: Annotated[int | None, Field(ge=1, le=9999)] = None
    bit_order: BitOrder = "lsb"
    row_order: RowOrder = "bottom"


class LayoutFound(BaseModel):
    """A layout that an upload may have: `planes` whole planes, and `left_bytes` more.

    `plausibility` is near 1 where neighbouring pixels are alike in space and time, and near 0 for noise.
    """

    format: SourceFormat
    width: int
    height: int
    bit_order: BitOrder
    planes: int
    left_bytes: int
    plausibility: float


class Inspection(BaseModel):
    """The layouts that an upload may have, the likeliest first, from the `received` of its `bytes`.

    `doubt` is a line for a file that fits none of them well. No file tells which row comes first: look at a preview.
    """

    upload: str
    bytes: int
    received: int
    candidates: list[LayoutFound]
    doubt: str | None
