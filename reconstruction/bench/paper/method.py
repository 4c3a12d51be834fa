"""Defines the cells of a protocol: a method on one recording for a length of time; and the tables they fill."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field, replace
from typing import Any

from acquisition.scenes.catalog import SCENES
from reconstruction.bench.conventions import HOLDOUT, seed_of
from reconstruction.bench.streams import Slowing
from reconstruction.errors import BadRunError
from reconstruction.run.configuration import ReconstructionConfig


@dataclass(frozen=True)
class Change:
    """A change of a recording before a method sees it; by default none.

    `nominal`: the rig is the true one misplaced, as in the pose bench, so that the poses have to be found. `every`:
    one of so many planes is left, by dropping the others or by re-integrating their spikes (`slowing`).
    """

    nominal: bool = False
    every: int = 1
    slowing: Slowing = "drop"

    @property
    def label(self) -> str:
        """The part of a file's name that tells the change; empty where there is none."""
        slower = f"{self.slowing}{self.every}" if self.every > 1 else ""
        return "-".join(part for part in ("nominal" if self.nominal else "", slower) if part)


@dataclass(frozen=True)
class Effort:
    """The length of a run: wall seconds from recording to last step, or training steps."""

    budget_s: float | None = None
    steps: int | None = None

    @property
    def label(self) -> str:
        """The text behind the @ in a name."""
        return f"{self.budget_s:g}" if self.steps is None else f"{self.steps}steps"

    def __str__(self) -> str:
        """Return the length with its unit."""
        return f"{self.budget_s:g} s" if self.steps is None else f"{self.steps} steps"


@dataclass(frozen=True)
class Method:
    """A named way to reconstruct: `choices` are the configuration's fields that differ from the default."""

    name: str
    choices: dict[str, Any] = field(default_factory=dict)
    change: Change = field(default_factory=Change)

    def config(self, effort: Effort, seed: int) -> ReconstructionConfig:
        """Return the configuration of one run; raises BadRunError for a name this revision does not know."""
        usual = {"holdout": HOLDOUT, "budget_s": effort.budget_s, "steps": effort.steps}
        return ReconstructionConfig(seed=seed, **(usual | self.choices))

    def changed(self, name: str, change: Change | None = None, **choices: object) -> Method:
        """Return a method that differs in its name, its `choices` and, where given, its `change`."""
        return Method(name, self.choices | choices, self.change if change is None else change)

    def on(self, scene: str, effort: Effort) -> Cell:
        """Return the run of a scene's first seed."""
        return Cell(self, scene, seed_of(scene), effort)

    @property
    def finds_poses(self) -> bool:
        """True where the training cameras' poses are found."""
        return self.choices.get("init", "sweep") != "sweep"


@dataclass(frozen=True)
class Row:
    """A line of a table: a method, or the reason why there is none; `paper` names the published line beside it."""

    label: str
    method: Method | None = None
    paper: str | None = None
    omitted: str = ""


@dataclass(frozen=True)
class Table:
    """Rows that answer one question; `about` says what they share."""

    name: str
    title: str
    about: str
    rows: tuple[Row, ...]


@dataclass(frozen=True)
class Cell:
    """One run."""

    method: Method
    scene: str
    seed: int
    effort: Effort

    @property
    def name(self) -> str:
        """The name of the cell, which no other cell of a protocol has."""
        return f"{self.scene}-{self.seed}-{self.method.name}-{self.effort.label}"


@dataclass(frozen=True)
class Batch:
    """Cells of one priority: rows of a table by method name (empty: all), scenes, and lengths.

    `seeds` are numbers of each scene's seeds.
    """

    table: str
    scenes: tuple[str, ...]
    efforts: tuple[Effort, ...]
    methods: tuple[str, ...] = ()
    seeds: tuple[int, ...] = (0,)

    def cells(self, row: Row) -> list[Cell]:
        """Return the batch's cells of one row."""
        method = row.method
        if method is None or (self.methods and method.name not in self.methods):
            return []
        recordings = [(scene, seed_of(scene, number)) for number in self.seeds for scene in self.scenes]
        return [Cell(method, scene, seed, effort) for effort in self.efforts for scene, seed in recordings]


@dataclass(frozen=True)
class Protocol:
    """Tables, and the batches that fill them, the most wanted first.

    Runs are begun for the tables `begun` and on the scenes `begun_on` (None: for all, on all); the others have the runs
    that were made before.
    """

    tables: tuple[Table, ...]
    batches: tuple[Batch, ...]
    begun: tuple[str, ...] | None = None
    begun_on: tuple[str, ...] | None = None

    def of(self, names: tuple[str, ...]) -> Protocol:
        """Return the protocol of these tables alone; raises BadRunError for a name that is none."""
        _check("tables", names, [table.name for table in self.tables])
        tables = tuple(t for t in self.tables if t.name in names)
        return Protocol(tables, tuple(b for b in self.batches if b.table in names))

    def beginning(self, names: tuple[str, ...]) -> Protocol:
        """Return the protocol with runs begun for these tables alone; raises BadRunError for a name that is none."""
        _check("tables", names, [table.name for table in self.tables])
        return replace(self, begun=names)

    def beginning_on(self, scenes: tuple[str, ...]) -> Protocol:
        """Return the protocol with runs begun on these scenes alone; raises BadRunError for one that it has not."""
        _check("scenes", scenes, dict.fromkeys(scene for batch in self.batches for scene in batch.scenes))
        return replace(self, begun_on=scenes)

    def on(self, scenes: tuple[str, ...]) -> Protocol:
        """Return the protocol on other scenes; raises BadRunError for one that is not there."""
        _check("scenes", scenes, SCENES)
        return replace(self, batches=tuple(replace(b, scenes=scenes) for b in self.batches))

    def wanted(self, table: Table, row: Row) -> list[Cell]:
        """Return the cells that a row of a table is the mean of, at every length."""
        batches = [b for b in self.batches if b.table == table.name]
        return list({cell.name: cell for b in batches for cell in b.cells(row)}.values())

    def cells(self) -> list[Cell]:
        """Return every cell once, the most wanted first."""
        rows = {table.name: table.rows for table in self.tables}
        found = [cell for b in self.batches for row in rows[b.table] for cell in b.cells(row)]
        return list({cell.name: cell for cell in found}.values())

    def begins(self) -> set[str]:
        """Return the names of the cells that are begun where they have no run."""
        asked = self if self.begun is None else self.of(self.begun)
        return {cell.name for cell in asked.cells() if self.begun_on is None or cell.scene in self.begun_on}


def _check(what: str, names: Collection[str], known: Collection[str]) -> None:
    """Refuse names that are not known; `what` they name stands in the message."""
    if not set(names) <= set(known):
        raise BadRunError(f"found the {what} {', '.join(names)}", f"some of {', '.join(known)}")
