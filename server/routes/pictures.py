"""Pictures: sent once, and afterwards only confirmed by their tag."""

from typing import Any

from fastapi import Response

from server.routes.parameters import not_modified
from server.services.previews import Picture

PNG: dict[int | str, dict[str, Any]] = {
    200: {"content": {"image/png": {"schema": {"type": "string", "format": "binary"}}}},
    304: {"description": "It has not changed since."},
}


def answer(if_none_match: str | None, picture: Picture) -> Response:
    """Return the picture, or 304 if the client already has it."""
    headers = {"ETag": picture.etag, "Cache-Control": "no-cache"}
    return not_modified(if_none_match, headers) or Response(picture.png, media_type="image/png", headers=headers)
