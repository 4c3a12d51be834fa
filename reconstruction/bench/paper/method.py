"""What a cell of a table is: a method, with what is done to the recording before it, on one recording, for so long."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

from acquisition.scenes.catalog import DEVELOPMENT, DEVELOPMENT_SEEDS, EVALUATION_SEEDS, SCENES
from reconstruction.bench.clips import Slowing
from reconstruction.bench.variants import HOLDOUT
from reconstruction.errors import BadRunError
from reconstruction.run.configuration import ReconstructionConfig


@dataclass(frozen=True)
class Change:
    """What is done to a recording before a method sees it; nothing, as it stands.

    `nominal`: its rig is the true one misplaced, as the pose bench does, so that the poses have to be found. `every`:
    only one of so many planes is left, by dropping the others or by re-integrating their spikes.
    """

    nominal: bool = False
    every: int = 1
    slowing: Slowing = "drop"

    @property
    def label(self) -> str:
        """Its name in a file's; empty where nothing is done."""
        slower = f"{self.slowing}{self.every}" if self.every > 1 else ""
        return "-".join(part for part in ("nominal" if self.nominal else "", slower) if part)


@dataclass(frozen=True)
class Effort:
    """How long a run may take: seconds of the wall from recording to last step, or training steps."""

    budget_s: float | None = None
    steps: int | None = None

    @property
    def label(self) -> str:
        """What stands behind the @ in a name."""
        return f"{self.budget_s:g}" if self.steps is None else f"{self.steps}steps"

    def __str__(self) -> str:
        return f"{self.budget_s:g} s" if self.steps is None else f"{self.steps} steps"


@dataclass(frozen=True)
class Method:
    """`choices` are the configuration's fields that differ from the default."""

    name: str
    choices: dict[str, Any] = field(default_factory=dict)
    change: Change = field(default_factory=Change)

    def config(self, effort: Effort, seed: int) -> ReconstructionConfig:
        """The configuration of one run; raises BadRunError for a name this revision does not know."""
        length = {"budget_s": effort.budget_s, "steps": effort.steps}
        return ReconstructionConfig(holdout=HOLDOUT, seed=seed, **length, **self.choices)

    def changed(self, name: str, change: Change | None = None, **choices: object) -> Method:
        """A method that differs in this alone."""
        return Method(name, self.choices | choices, self.change if change is None else change)

    def on(self, scene: str, effort: Effort) -> Cell:
        """The run of a scene's first seed."""
        return Cell(self, scene, seed_of(scene, 0), effort)


@dataclass(frozen=True)
class Row:
    """A line of a table: a method of ours, or the reason why there is none; `paper` names the line it stands beside."""

    label: str
    method: Method | None = None
    paper: str | None = None
    omitted: str = ""


@dataclass(frozen=True)
class Table:
    """Rows that answer one question; `about` says what they have in common."""

    name: str
    title: str
    about: str
    rows: tuple[Row, ...]


def seed_of(scene: str, number: int) -> int:
    """The seed of that number; 0 is the one that every bench uses."""
    if scene in DEVELOPMENT:
        return (*DEVELOPMENT_SEEDS[1:], DEVELOPMENT_SEEDS[0])[number]
    return EVALUATION_SEEDS[number]


@dataclass(frozen=True)
class Cell:
    """One run."""

    method: Method
    scene: str
    seed: int
    effort: Effort

    @property
    def name(self) -> str:
        """One word that no other cell has."""
        return f"{self.scene}-{self.seed}-{self.method.name}-{self.effort.label}"


@dataclass(frozen=True)
class Batch:
    """Cells of one priority: rows of a table by method name (empty: all), recordings and lengths.

    `seeds`: which of each scene's seeds, by number.
    """

    table: str
    scenes: tuple[str, ...]
    efforts: tuple[Effort, ...]
    methods: tuple[str, ...] = ()
    seeds: tuple[int, ...] = (0,)

    def cells(self, row: Row) -> list[Cell]:
        """Those of one row."""
        method = row.method
        if method is None or (self.methods and method.name not in self.methods):
            return []
        recordings = [(scene, seed_of(scene, number)) for number in self.seeds for scene in self.scenes]
        return [Cell(method, scene, seed, effort) for effort in self.efforts for scene, seed in recordings]


@dataclass(frozen=True)
class Protocol:
    """Tables, and the batches that fill them, the most wanted first."""

    tables: tuple[Table, ...]
    batches: tuple[Batch, ...]

    def of(self, names: tuple[str, ...]) -> Protocol:
        """The tables of these names alone; raises BadRunError for a name that is none."""
        known = [table.name for table in self.tables]
        if not set(names) <= set(known):
            raise BadRunError(f"found the tables {', '.join(names)}", f"some of {', '.join(known)}")
        tables = tuple(t for t in self.tables if t.name in names)
        return Protocol(tables, tuple(b for b in self.batches if b.table in names))

    def on(self, scenes: tuple[str, ...]) -> Protocol:
        """The same on other scenes; raises BadRunError for one that is not there."""
        if not set(scenes) <= set(SCENES):
            raise BadRunError(f"found the scenes {', '.join(scenes)}", f"some of {', '.join(SCENES)}")
        return Protocol(self.tables, tuple(replace(b, scenes=scenes) for b in self.batches))

    @property
    def hours(self) -> float:
        """What all cells with a budget take, scoring and simulation left out."""
        return sum(cell.effort.budget_s or 0.0 for cell in self.cells()) / 3600

    def wanted(self, table: Table, row: Row) -> list[Cell]:
        """The cells that a row of a table is the mean of, at every effort."""
        batches = [b for b in self.batches if b.table == table.name]
        return list({cell.name: cell for b in batches for cell in b.cells(row)}.values())

    def cells(self) -> list[Cell]:
        """Every cell once, the most wanted first."""
        rows = {table.name: table.rows for table in self.tables}
        found = [cell for b in self.batches for row in rows[b.table] for cell in b.cells(row)]
        return list({cell.name: cell for cell in found}.values())
