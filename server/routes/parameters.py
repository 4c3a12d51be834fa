"""Parameters and answers that several routes share, and their way to the services."""

from collections import Counter
from collections.abc import AsyncIterator, Iterator
from typing import Annotated, Any, Protocol, TypeVar

from fastapi import Depends, Header, Query, Request, Response
from fastapi.concurrency import run_in_threadpool
from fastapi.dependencies.models import Dependant

from server.errors import UnknownReferenceError
from server.etags import matches
from server.schemas.captures import SHOWN
from server.services.previews import Picture
from server.services.services import Services


async def _services(request: Request) -> Services:  # a plain function would cost every request a turn of a thread
    return request.app.state.services


TheServices = Annotated[Services, Depends(_services)]


def _making_room(services: TheServices) -> Iterator[None]:
    with services.store.disk.making_room():
        yield


def _expect_known_query(request: Request) -> None:
    """Raise UnknownReferenceError for a name in the query that the route does not know, or that comes twice."""
    known = _query_names(request.scope["route"].dependant)
    for name, number in Counter(name for name, _ in request.query_params.multi_items()).items():
        if name not in known:
            expected = f"one of {', '.join(sorted(known))}" if known else "none here"
            raise UnknownReferenceError(f"found the query parameter {name[:60]!r}", expected)
        if number > 1:
            raise UnknownReferenceError(f"found the query parameter {name} {number} times", "it once")


def _query_names(dependant: Dependant) -> set[str]:
    names = {field.alias for field in dependant.query_params}
    return names.union(*map(_query_names, dependant.dependencies))


MAKES_ROOM = Depends(_making_room)  # of routes that must work on a full disk
KNOWN_QUERY = Depends(_expect_known_query)
IdempotencyKey = Annotated[
    str | None,
    Header(
        alias="Idempotency-Key",
        min_length=1,
        max_length=200,
        pattern="^[!-~]+$",
        description="Sent again, it makes nothing twice.",
    ),
]
IfNoneMatch = Annotated[str | None, Header(alias="If-None-Match", max_length=4000)]
Limit = Annotated[int, Query(ge=1, le=1000, description="Entries of a page.")]
Word = Annotated[str | None, Query(pattern="^[!-~]{1,80}$")]  # an id or a type, to list what has it
Named = Annotated[str | None, Query(min_length=1, max_length=80, pattern=SHOWN)]

Searched = Annotated[
    str | None,
    Query(min_length=1, max_length=80, pattern=SHOWN, description="A part of the name, note, id or rig, in any case."),
]


async def _again(request: Request, services: TheServices, key: IdempotencyKey = None) -> AsyncIterator[bool]:
    """Tell whether a request comes again under its key, and note it once it has succeeded."""
    if key is None:
        yield False
        return
    asked = f"{request.method} {request.url.path} {(await request.body()).decode(errors='replace')}"
    known = services.store.idempotency
    again = await run_in_threadpool(known.seen, key, asked)
    yield again
    if not again:
        await run_in_threadpool(known.note, key, asked)


Again = Annotated[bool, Depends(_again)]  # of routes that change what is there: True, and nothing is to be changed


def cursor_of(letter: str, *, ordered: bool = False) -> Any:
    """Return the description of a cursor of a list whose ids begin with `letter`, and which may have several orders."""
    place = r"(w\d\.\d{1,9}\.\d{1,16}\.)?" if ordered else ""
    pattern = rf"^{place}{letter}\d{{8}}-\d{{6}}-[0-9a-f]{{8}}$"
    return Query(pattern=pattern, description="`next` of the page before.")


class _HasId(Protocol):
    id: str


_E = TypeVar("_E", bound=_HasId)


def located(response: Response, kind: str, entry: _E) -> _E:
    """Return `entry`, one of the `kind` (jobs, captures ...), and put its address into the answer's Location."""
    response.headers["Location"] = f"/v1/{kind}/{entry.id}"
    return entry


def not_modified(if_none_match: str | None, headers: dict[str, str]) -> Response | None:
    """Return the answer 304 if the client already has what the ETag of `headers` names, else None."""
    known = matches(if_none_match or "", headers["ETag"], weak=True)
    return Response(status_code=304, headers=headers) if known else None


PNG: dict[int | str, dict[str, Any]] = {
    200: {"content": {"image/png": {"schema": {"type": "string", "format": "binary"}}}},
    304: {"description": "It has not changed since."},
}


def png(if_none_match: str | None, picture: Picture) -> Response:
    """Return the picture, or 304 if the client already has it."""
    headers = {"ETag": picture.etag, "Cache-Control": "no-cache"}
    return not_modified(if_none_match, headers) or Response(picture.png, media_type="image/png", headers=headers)
