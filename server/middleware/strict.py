"""Strict JSON, which every reader understands alike: each name once, no NaN, a modest depth."""

import json
from typing import Any

from starlette.concurrency import run_in_threadpool

from server.errors import MalformedError

_DEEPEST = 32  # levels of nesting
_LONG = 2**14  # bytes; a longer body is worth a thread of its own


async def check_json(body: bytes) -> None:
    """Raise MalformedError for JSON that readers understand differently.

    Text that is no JSON at all is left to the framework, whose answer tells the line and column.
    """
    if len(body) < _LONG:
        _check(body)
    else:
        await run_in_threadpool(_check, body)


def _check(body: bytes) -> None:
    try:
        document = json.loads(body, object_pairs_hook=_object, parse_constant=_constant)
    except RecursionError as error:
        raise _too_deep() from error
    except ValueError:
        return
    level = [document]
    for _ in range(_DEEPEST):
        level = [child for item in level for child in _children(item)]
        if not level:
            return
    raise _too_deep()


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    made = dict(pairs)
    if len(made) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in made if names.count(name) > 1)
        raise MalformedError(f"found the member {twice[:60]!r} twice", "it once")
    return made


def _constant(name: str) -> float:
    raise MalformedError(f"found {name}", "a number: JSON has no other")


def _children(item: Any) -> list[Any]:
    if isinstance(item, dict):
        return list(item.values())
    return item if isinstance(item, list) else []


def _too_deep() -> MalformedError:
    return MalformedError(f"found values nested deeper than {_DEEPEST}", "a flat document")
