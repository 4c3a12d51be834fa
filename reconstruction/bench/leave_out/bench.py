"""Measures a plan against a run with every choice switched, and with a single one: seconds, memory and error.

Every run is made in a process of its own, at equal steps and at equal time. `cost_db` is how much better the other run
is (a plan may cost 0.1 dB), `saved_s` and `saved_mb` how much more processor time and memory it takes. The run with
every choice switched is no bound: its paths are straight, where plans with movers choose bodies. Of a single decision
these stand beside the plan's own claims. The price of a wrong plan is measured by a mover that it misses, with
the watch and without.

Clips are small, 200x125 and mostly 200 planes; one is long and at rest. Each run has as many Gaussians as its plan
chooses, unless an arm says otherwise. Compare figures with one another, not with those of other benches.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

from acquisition.bench_document import BenchDocument
from acquisition.devices.open import Simulation
from acquisition.durable import made_aside
from acquisition.progress import Progress
from acquisition.recording.reader import Recording
from acquisition.session.record import simulate
from reconstruction.bench.conventions import apart, in_time, kept
from reconstruction.bench.leave_out.cases import BLIND, CASES, GREY, MISSED, PLAN, UNWATCHED, Arm, Job, PlanCase
from reconstruction.bench.paper.digest import code_and_machine, this_code
from reconstruction.errors import ReconstructionError
from rigs.toml import catalog_rig

SIZE = (200, 125)  # pixels of a clip
STEPS, QUICK_STEPS, BUDGET_S = 400, 40, 10.0
SCORES = ("psnr_db", "dynamic_psnr_db")
OMISSIONS = (
    f"one seed a case; clips of {SIZE[0]}x{SIZE[1]}",
    "colour: three channels; the third-degree harmonics that the plan's bytes are against are not in the engine",
    "pixels, light: nothing to switch; no case has maps of its pixels",
)


@dataclass(frozen=True)
class Runs:
    """The folder of the runs, and their length in steps and in seconds (None: at equal steps alone).

    Without `time_left` none is begun.
    """

    work: Path
    steps: int = STEPS
    budget_s: float | None = BUDGET_S
    time_left: Callable[[], bool] = lambda: True

    def row(self, case: PlanCase, arm: Arm, decision: str, budget_s: float | None = None) -> dict:
        """Return the run of a case by an arm: measured now, or found in `work`; raises ReconstructionError."""
        extent = f"{budget_s:g}s" if budget_s else f"{self.steps}"
        name = f"{case.name}-{arm.name}-{extent}"
        about = {"case": case.name, "scene": case.scene, "seed": case.seed, "decision": decision}
        about |= {"run": "plan" if arm in (PLAN, GREY, BLIND) else "all", "extent": extent}

        def measure() -> dict:
            length = (None, budget_s) if budget_s else (self.steps, None)
            return apart(partial(_measured, Job(recorded(case, self.work), arm, self.work / f"{name}.run", *length)))

        key = code_and_machine() | {"arm": asdict(arm)}
        return about | kept(self.work / f"{name}.json", in_time(self.time_left, measure), key)


def bench_leave_out(
    work: Path,
    progress: Progress,
    *,
    quick: bool = False,
    cases: Sequence[PlanCase] = CASES,
    time_left: Callable[[], bool] = lambda: True,
) -> BenchDocument:
    """Run every case by its plan, with every choice switched, and with each of its decisions.

    `quick`: the first case alone, in few steps. Without `time_left` no further run is begun, and a case that lacks one
    is left out. Recordings and runs lie in a folder of `work` that this code has of its own; a run found there is not
    repeated, so that a stopped bench resumes.
    """
    document, work = BenchDocument("leave-out"), work / this_code()
    work.mkdir(parents=True, exist_ok=True)
    runs = Runs(work, QUICK_STEPS, None, time_left) if quick else Runs(work, time_left=time_left)
    todo = list(cases[:1] if quick else [MISSED, *cases])
    for number, case in enumerate(todo):
        progress(number / len(todo), f"{case.name}: {case.scene}, seed {case.seed}")
        found, compare = BenchDocument("leave-out"), _mistaken if case is MISSED else _compare
        try:
            compare(found, runs, case)
        except ReconstructionError as error:
            document.omissions.append(f"{case.name}: {error}")
            continue
        document.rows += found.rows
        document.summary |= found.summary
        document.omissions += found.omissions
    document.omissions += OMISSIONS
    progress(1.0, f"{len(document.rows)} runs")
    return document


def _compare(document: BenchDocument, runs: Runs, case: PlanCase) -> None:
    """Add a case at equal steps and at equal time, and each of its decisions."""
    plan, switched = runs.row(case, PLAN, "all"), runs.row(case, case.all, "all")
    document.rows += [plan, switched]
    document.summary |= costs(case.name, plan, switched)
    if runs.budget_s:
        pair = [runs.row(case, arm, "all", runs.budget_s) for arm in (PLAN, case.all)]
        document.rows += pair
        gaps = costs(case.name, *pair)
        document.summary |= {f"{k}@{runs.budget_s:g}": v for k, v in gaps.items() if k.endswith("cost_db")}
    for arm in case.switches:
        base = plan if arm.channels is None else runs.row(case, GREY, arm.name)
        other = runs.row(case, arm, arm.name)
        document.rows += [other] if base is plan else [base, other]
        key = f"{case.name}.{arm.name}"
        document.summary |= costs(key, base, other) | claims(key, plan, arm.name)
    document.omissions += [
        f"{case.name}, {row['decision']}, {row['run']}: refused, {row['refused']}"
        for row in document.rows
        if row["case"] == case.name and "refused" in row
    ]


def costs(key: str, plan: dict, other: dict) -> dict[str, float]:
    """Return what a plan costs in dB and saves in processor seconds and MB, as far as both runs have them."""
    if "refused" in plan or "refused" in other:
        return {}
    found = {f"{key}.saved_s": other["cpu_s"] - plan["cpu_s"], f"{key}.saved_mb": other["peak_mb"] - plan["peak_mb"]}
    for score in SCORES:
        if score in plan and score in other:
            found[f"{key}.{score.replace('psnr', 'cost')}"] = other[score] - plan[score]
    return found


def claims(key: str, plan: dict, decision: str) -> dict[str, float]:
    """Return what the plan said that a decision saves, where it said so."""
    said = plan.get("decisions", {}).get(decision, {})
    units = {"claimed_s": ("saves_s", 1.0), "claimed_mb": ("saves_bytes", 1e-6)}
    return {f"{key}.{name}": said[k] * unit for name, (k, unit) in units.items() if said.get(k) is not None}


def _mistaken(document: BenchDocument, runs: Runs, case: PlanCase) -> None:
    """Add a case whose plan took a mover for still: undone by the watch, and left as it is."""
    watched, left = runs.row(case, BLIND, "watch"), runs.row(case, UNWATCHED, "watch")
    document.rows += [watched, left]
    gains = costs(case.name, left, watched)
    document.summary |= {k.replace("cost", "gained"): v for k, v in gains.items() if k.endswith("cost_db")}
    facts = watched.get("decisions", {}).get("watch", {}).get("facts", {})
    found = facts.get("pixels", 0) > 0
    document.summary[f"{case.name}.found"] = float(found)
    if found:
        document.summary[f"{case.name}.found_at_step"] = float(facts["step"])


def _measured(job: Job) -> dict:
    from reconstruction.bench.leave_out.run import measured  # loads torch, in the process of the run alone

    return measured(job)


def recorded(case: PlanCase, work: Path) -> Path:
    """Return the recording of a case in `work`, simulated where there is none; a dead camera's planes are zeros."""
    unlike = "".join(f"-{name}-{value:g}" for name, value in case.devices.items())
    path = work / f"{case.scene}-{case.seed}-{case.ticks}{f'-no-{case.dead}' if case.dead else ''}{unlike}"
    if path.exists():
        return path
    rig = catalog_rig("lab3x3").scaled(*SIZE)
    with made_aside(path) as aside:
        apart(partial(simulate, Simulation(case.scene, case.seed, **case.devices), rig, case.ticks, aside))
        if case.dead:
            file = aside / Recording.open(aside).manifest.camera(case.dead).file
            file.write_bytes(bytes(file.stat().st_size))
    return path
