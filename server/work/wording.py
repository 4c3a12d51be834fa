"""Says what a command said in the words of a request: who queued a job has typed no options."""

import re

_OPTION = re.compile(r"`spike4dgs [^`]*`|(?<![\w-])('?)--([a-z][a-z0-9-]*)\1")  # what is quoted as a command stays one
_FIELDS = {"at": "at_s", "tick-rate": "tick_rate_hz", "pre-trigger": "pre_trigger_ms", "rejoin": "rejoin_s"}
_PLACES = {"out": "folder"}  # options that no request has


def in_request_words(text: str) -> str:
    """Return a message of `spike4dgs` with fields of a request, marked as `field`, where it names options."""
    return _OPTION.sub(_renamed, text.removeprefix("Error: "))  # the prefix is the option parser's


def _renamed(found: re.Match[str]) -> str:
    option = found[2]
    if option is None:
        return found[0]
    return _PLACES.get(option) or f"`{_FIELDS.get(option, option.replace('-', '_'))}`"
