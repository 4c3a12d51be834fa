"""Entity tags: they name the version of a thing that a client saw."""

import re
from urllib.parse import quote

_ONE = re.compile(r'\s*(W/)?("[\x21\x23-\x7e]*")\s*')


def tag(*parts: object) -> str:
    """Return a strong entity tag, quotes included."""
    return '"' + "-".join(quote(str(part), safe="") for part in parts) + '"'


def matches(header: str, etag: str, *, weak: bool = False) -> bool:
    """Return whether an If-Match header or, compared as `weak`, an If-None-Match names `etag` (RFC 9110, 13.1)."""
    if header.strip() == "*":
        return True
    found = [_ONE.fullmatch(part) for part in header.split(",")]
    return any(one is not None and one[2] == etag and (weak or not one[1]) for one in found)
