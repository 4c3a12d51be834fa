"""Estimates how long jobs take: from their budget, the share that is done, and the last jobs of their type."""

import json
from collections.abc import Callable, Mapping
from statistics import median
from typing import Any

from reconstruction.run.configuration import FOLLOW
from reconstruction.run.spans import PLANES
from server.engine import stages_of
from server.store.entries import Entries, Listed

_LOOK_AT = 20  # newest finished jobs of a type
_LEAST_FRACTION = 0.05  # of a stage, before its own speed tells anything
# Options that hardly change the duration.
_NOT_ALIKE = ("capture", "job", "name", "priority", "seed", "holdout", "follow")
_LENGTHS = ("from_tick", "to_tick")  # options that change it by the planes alone
_SAMPLED = ("calibrate", "check-rig")  # types that read as many planes of any capture
_SCORING = "report"  # the stage after the last checkpoint
_UNCOUNTED = (FOLLOW, _SCORING)  # stages that a budget does not count
Seconds = dict[str, float]
_Earlier = tuple[dict[str, Any], float | None, Seconds]  # the options of a job, its length, and what its stages took


class Durations:
    """The durations of one moment's jobs; each kind of earlier job is looked up once.

    `planes_of` has the planes of a capture by its id, None where nobody knows.
    """

    def __init__(self, entries: Entries, planes_of: Callable[[str], int | None]) -> None:
        self._entries = entries
        self._planes_of = planes_of
        self._known: dict[str, list[_Earlier]] = {}

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
        request = json.loads(entry.request)
        stages = stages_of(entry.type, request)
        stage, spent = progress.get("stage"), progress.get("seconds", {})
        if stage == FOLLOW:  # it lasts as long as the recording
            return None
        at = stages.index(stage) if stage in stages else 0
        usual = self._usual(entry.type, request)
        here = _rest(spent.get(stages[at], 0.0), progress.get("fraction", 0.0), usual.get(stages[at]))
        later = [usual.get(name) for name in stages[at + 1 :]]
        if request.get("budget_s") is not None and stages[at] != _SCORING:
            used = sum(seconds for name, seconds in spent.items() if name not in _UNCOUNTED)
            return max(0.0, request["budget_s"] - used) + (usual.get(_SCORING) or 0.0)
        return None if here is None or None in later else here + sum(s for s in later if s is not None)

    def _usual(self, entry_type: str, request: Mapping[str, Any]) -> Seconds:
        """Return the median seconds of each stage over earlier jobs with the same options or, without any, over all."""
        found, length = self._finished(entry_type), self._length(entry_type, request)
        wanted = _alike(request)
        alike = [one for one in found if one[0] == wanted] or found
        same = [_as_long(seconds, then, length) for _, then, seconds in alike]
        return {name: median(s[name] for s in same if name in s) for name in {name for s in same for name in s}}

    def _finished(self, entry_type: str) -> list[_Earlier]:
        if entry_type not in self._known:
            found = self._entries.finished(entry_type, _LOOK_AT)
            requests = [json.loads(entry.request) for entry in found]
            self._known[entry_type] = [
                (_alike(asked), self._length(entry_type, asked), json.loads(entry.progress).get("seconds", {}))
                for asked, entry in zip(requests, found, strict=True)
            ]
        return self._known[entry_type]

    def _length(self, entry_type: str, request: Mapping[str, Any]) -> float | None:
        """Return in what proportion a job takes longer, by the planes that it reads; None where nothing tells."""
        capture = request.get("capture")
        if entry_type in _SAMPLED or capture is None or request.get("ticks") is not None:
            return None
        planes = self._planes_of(capture)
        if planes is None:
            return None
        first, last = (request.get(name) for name in _LENGTHS)
        read = min(planes, planes if last is None else last) - max(0, first or 0)
        return max(1.0, read / (PLANES if entry_type == "reconstruct" else 1))  # a span takes what a part of it does


def _as_long(seconds: Seconds, then: float | None, now: float | None) -> Seconds:
    """Return the seconds of the stages of an earlier job for one of another length."""
    if then is None or now is None:
        return seconds
    return {stage: took_s * now / then for stage, took_s in seconds.items()}


def _rest(spent_s: float, fraction: float, usual_s: float | None) -> float | None:
    """Return the seconds left of a stage, by its own speed or else by what is usual."""
    if fraction >= _LEAST_FRACTION and spent_s > 0:
        return spent_s * (1 - fraction) / fraction
    return None if usual_s is None else max(0.0, usual_s - spent_s)


def _alike(request: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in request.items() if name not in (*_NOT_ALIKE, *_LENGTHS)}
