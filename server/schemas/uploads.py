"""Files that clients send, piece by piece."""

from typing import Annotated, Literal

from pydantic import BaseModel, Field

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
