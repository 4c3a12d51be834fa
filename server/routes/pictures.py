"""How a picture is answered: once, and then by its tag."""

from typing import Any

from fastapi import Request, Response

from server.services.previews import Picture

PNG: dict[int | str, dict[str, Any]] = {
    200: {"content": {"image/png": {"schema": {"type": "string", "format": "binary"}}}},
    304: {"description": "It has not changed since."},
}


def answer(request: Request, picture: Picture) -> Response:
    """The picture, or 304 where the client has it already."""
    headers = {"ETag": picture.etag, "Cache-Control": "no-cache", "X-Content-Type-Options": "nosniff"}
    known = [tag.strip().removeprefix("W/") for tag in request.headers.get("if-none-match", "").split(",")]
    if picture.etag in known or known == ["*"]:
        return Response(status_code=304, headers=headers)
    return Response(picture.png, media_type="image/png", headers=headers)
