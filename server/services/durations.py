"""Estimates how long jobs take: from their budget, the share that is done, and the last jobs of their type."""

import json
from collections.abc import Mapping
from statistics import median
from typing import Any

from server.engine import stages_of
from server.store.entries import Entries, Listed

_LOOK_AT = 20  # newest finished jobs of a type
_LEAST_FRACTION = 0.05  # of a stage, before its own speed tells anything
_NOT_ALIKE = ("capture", "job", "name", "priority", "seed", "holdout")  # options that hardly change the duration
_SCORING = "report"  # the stage that a budget does not count
Seconds = dict[str, float]


class Durations:
    """The durations of one moment's jobs; each kind of earlier job is looked up once."""

    def __init__(self, entries: Entries) -> None:
        self._entries = entries
        self._known: dict[str, list[tuple[dict[str, Any], Seconds]]] = {}

    def whole(self, entry: Listed) -> float | None:
        """Return the seconds that a queued entry will take; None where nothing tells."""
        return self._left(entry, {"stage": json.loads(entry.progress).get("stage")})

    def left(self, entry: Listed, quiet_s: float) -> float | None:
        """Return the seconds that a running entry still takes, whose last report is `quiet_s` old.

        None where nothing tells, or where it has taken twice as long as was expected.
        """
        left = self._left(entry, json.loads(entry.progress))
        if left is None or quiet_s > 2 * left + 1:
            return None
        return max(0.0, left - quiet_s)

    def _left(self, entry: Listed, progress: Mapping[str, Any]) -> float | None:
        stages, request = stages_of(entry.type), json.loads(entry.request)
        stage, spent = progress.get("stage"), progress.get("seconds", {})
        at = stages.index(stage) if stage in stages else 0
        usual = self._usual(entry.type, request)
        here = _rest(spent.get(stages[at], 0.0), progress.get("fraction", 0.0), usual.get(stages[at]))
        later = [usual.get(name) for name in stages[at + 1 :]]
        if request.get("budget_s") is not None and stages[at] != _SCORING:
            used = sum(seconds for name, seconds in spent.items() if name != _SCORING)
            return max(0.0, request["budget_s"] - used) + (usual.get(_SCORING) or 0.0)
        return None if here is None or None in later else here + sum(s for s in later if s is not None)

    def _usual(self, entry_type: str, request: Mapping[str, Any]) -> Seconds:
        """Return the median seconds of each stage over earlier jobs with the same options or, without any, over all."""
        found = self._finished(entry_type)
        wanted = _alike(request)
        same = [seconds for asked, seconds in found if asked == wanted] or [seconds for _, seconds in found]
        return {name: median(s[name] for s in same if name in s) for name in {name for s in same for name in s}}

    def _finished(self, entry_type: str) -> list[tuple[dict[str, Any], Seconds]]:
        if entry_type not in self._known:
            found = self._entries.finished(entry_type, _LOOK_AT)
            self._known[entry_type] = [
                (_alike(json.loads(entry.request)), json.loads(entry.progress).get("seconds", {})) for entry in found
            ]
        return self._known[entry_type]


def _rest(spent_s: float, fraction: float, usual_s: float | None) -> float | None:
    """Return the seconds left of a stage, by its own speed or else by what is usual."""
    if fraction >= _LEAST_FRACTION and spent_s > 0:
        return spent_s * (1 - fraction) / fraction
    return None if usual_s is None else max(0.0, usual_s - spent_s)


def _alike(request: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in request.items() if name not in _NOT_ALIKE}
