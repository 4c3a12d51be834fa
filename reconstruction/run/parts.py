"""The parts of a training in spans, and the folder in which each leaves a file of its own.

Light enough for a process that hands parts out and learns none: it needs neither torch nor arrays.
"""

import json
import os
import shutil
from collections.abc import Collection, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path

from acquisition.durable import write_json

STILL = "still"
STILL_WEIGHT = 1.5  # trainings of a usual span that the training of the still scene is worth
LEAST_WEIGHT = 0.25  # the same of a span that shows little: its points and bodies take a while too
LISTED = "images/parts.json"  # what there is to hand out, as the images stage found it
_FOLDER, _CONTENT, _FAILED = "spans", ".pt", ".failed.json"


@dataclass(frozen=True)
class Part:
    """A part by its name: `weight` in trainings of a usual span."""

    name: str
    weight: float = 1.0


@dataclass(frozen=True)
class Failure:
    """The reason why a part was given up, and after how many tries; `bad_input`: it would fail again."""

    reason: str
    tries: int
    bad_input: bool = False


def span_name(number: int) -> str:
    """Return the name of a span's part."""
    return f"{number:06d}"


def parts_of(shown: Mapping[int, float]) -> list[Part]:
    """Return the still scene, then the spans, the heaviest first: a span weighs as much as it shows.

    `shown` has the share of the pixels that differ from the still scene, by the number of the span.
    """
    usual = sum(shown.values()) / max(1, len(shown))
    spans = [Part(span_name(number), max(share / usual, LEAST_WEIGHT)) for number, share in shown.items()]
    return [Part(STILL, STILL_WEIGHT), *sorted(spans, key=lambda part: -part.weight)]


def shares_of(parts: list[Part]) -> dict[str, tuple[float, float]]:
    """Return the shares of all weight, by part, that are before it and with it."""
    total, before, shares = sum(part.weight for part in parts), 0.0, {}
    for part in parts:
        shares[part.name] = (before / total, (before + part.weight) / total)
        before += part.weight
    return shares


class PartFolder:
    """The files of the parts of the run at `run`."""

    def __init__(self, run: Path) -> None:
        self._list = run / LISTED
        self.path = run / _FOLDER

    def note(self, parts: list[Part]) -> None:
        """Note which parts there are; none for a run that is not in spans."""
        if parts:
            write_json(self._list, [asdict(part) for part in parts])
        else:
            self._list.unlink(missing_ok=True)

    def noted(self) -> list[Part]:
        """Return the parts that were noted; none for a run that is not in spans, or of an earlier revision."""
        try:
            return [Part(**plain) for plain in json.loads(self._list.read_text())]
        except FileNotFoundError:
            return []

    def file(self, name: str) -> Path:
        """Return the file of a part's content."""
        return self.path / f"{name}{_CONTENT}"

    def there(self) -> set[str]:
        """Return the names of the parts whose content is there."""
        return self._names(_CONTENT)

    def given_up(self) -> set[str]:
        """Return the names of the parts that are marked as failed and are not there."""
        return self._names(_FAILED) - self.there()

    def failure(self, name: str) -> Failure | None:
        """Return why a part is marked as failed; None for one that is not."""
        try:
            return Failure(**json.loads((self.path / f"{name}{_FAILED}").read_text()))
        except FileNotFoundError:
            return None

    def give_up(self, name: str, failure: Failure) -> None:
        """Mark a part as failed."""
        self.path.mkdir(parents=True, exist_ok=True)
        write_json(self.path / f"{name}{_FAILED}", asdict(failure))

    def try_again(self, name: str) -> None:
        """Take back that a part is marked as failed."""
        (self.path / f"{name}{_FAILED}").unlink(missing_ok=True)

    def due(self, taken: Collection[str]) -> list[Part]:
        """Return the parts that can be handed out now, beside those that are `taken`: the still scene, then spans."""
        there, parts = self.there(), self.noted()
        if STILL not in there:
            parts = parts[:1]
        return [part for part in parts if part.name not in there and part.name not in taken]

    def forget(self) -> None:
        """Remove the folder whole: a process that still learns for it finds no place for what it has learnt."""
        with suppress(FileNotFoundError):
            self.path.rename(self.path.with_name(f".{_FOLDER}.{os.getpid()}.forgotten"))
        for left in self.path.parent.glob(f".{_FOLDER}.*.forgotten"):
            shutil.rmtree(left, ignore_errors=True)

    def _names(self, ending: str) -> set[str]:
        with suppress(FileNotFoundError):
            return {file.name.removesuffix(ending) for file in self.path.iterdir() if file.name.endswith(ending)}
        return set()
