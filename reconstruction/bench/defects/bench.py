"""Measures what each defect of real cameras and real light costs, alone and all together, with its cure and without.

All runs take the same steps and are scored on the centre camera. `cost_db` is what a defect takes from a recording of
the same scene by the same lenses that has maps of its pixels where the defect has: the clean one, or the one by the
same misplaced cameras whose rig file says where they are (`built`). It is a difference of means over the seeds of
trainings, and `cost_spread_db` the range of the differences seed by seed. `uncured_cost_db` is what a defect takes
where its cure is switched off.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from acquisition.bench_document import BenchDocument
from acquisition.errors import AcquisitionError
from acquisition.progress import Progress
from acquisition.revision import code_revision
from acquisition.scenes.catalog import BACKGROUNDS, DEVELOPMENT_SEEDS
from acquisition.scenes.glass import Glass
from acquisition.spikes.traits import Traits
from reconstruction.bench.conventions import HOLDOUT, apart, in_time, kept, means, named
from reconstruction.bench.defects.recordings import Defect, recorded, straightened
from reconstruction.bench.paper.digest import code_and_machine, this_code
from reconstruction.errors import ReconstructionError
from reconstruction.run.configuration import ReconstructionConfig
from rigs.rig import Rig
from rigs.toml import catalog_rig

STEPS, QUICK_STEPS = 600, 20
OFF = 2.0  # degrees, cm and percent that a nominal rig is off
SCORES = ("psnr_db", "dynamic_psnr_db", "abs_rel", "rotation_deg", "focal_percent")
Subject = tuple[str, int]  # a scene and its seed
SEEDS = (0, 1, 2)  # of the trainings of recordings whose costs are claimed; runs of the same spikes differ by dB
CLEAN = Defect("clean", seeds=SEEDS)
CLEAN_MAPS = Defect("clean-maps", maps=True)  # the sensors have a pattern of their own, which maps take out too
SPREAD = Traits(pixel_spread=0.03)
EVEN: dict[str, Any] = {"uncured": {"pixels": "even"}, "against": CLEAN_MAPS.name}
NINE = {"window": 9}
RIG_OFF = Defect("rig-off", {"rig_error": OFF}, uncured={"init": "sweep"}, against="built", seeds=SEEDS)
BUILT = Defect("built", told=RIG_OFF, seeds=SEEDS)
BENT_OFF = Defect("rig-off-bent-with-maps", {"rig_error": OFF}, bent=True, maps=True)
BUILT_BENT = Defect("built-bent-with-maps", told=BENT_OFF, against=BUILT.name, seeds=SEEDS)
TOGETHER = Defect(
    "together",
    {"traits": SPREAD, "camera_gains": 0.05, "camera_lags": 1.0, "rig_error": OFF},
    bent=True,
    maps=True,
    against=BUILT_BENT.name,
    seeds=SEEDS,
)
DEFECTS = (
    Defect("lens", bent=True),
    CLEAN_MAPS,
    Defect("pixels", {"traits": SPREAD}, maps=True, **EVEN),
    Defect("vignetting", {"glass": Glass(vignetting=0.3)}, maps=True, **EVEN),
    Defect("blur", {"glass": Glass(blur=0.5)}),
    Defect("gains", {"camera_gains": 0.05}, uncured={"gains": "off"}),
    Defect("lags", {"camera_lags": 1.0}, uncured={"gains": "off"}),
    Defect("harsh", {"sensor": "harsh"}, maps=True, **EVEN),
    BUILT,
    RIG_OFF,
    BUILT_BENT,
    TOGETHER,
    Defect("10-khz", rate_hz=10000, uncured=NINE),
    Defect("5-khz", rate_hz=5000, uncured=NINE),
    Defect("2-khz", rate_hz=2000, uncured=NINE),
    Defect("tenth-light", {"light": 0.1}, uncured=NINE),
    Defect("hundredth-light", {"light": 0.01}, uncured=NINE),
)
FEW = (BUILT, RIG_OFF, BUILT_BENT, TOGETHER)  # on the realistic scenes


@dataclass(frozen=True)
class Workshop:
    """The folder of recordings and runs, the rig, the length of a run in steps, and whether there is time for one."""

    work: Path
    rig: Rig
    steps: int = STEPS
    time_left: Callable[[], bool] = lambda: True

    def row(self, subject: Subject, defect: Defect, training_seed: int, *, cured: bool = True) -> dict:
        """Return a run of a scene and seed with a defect, cured or not: measured now, or kept by this code."""
        scene, seed = subject
        name = f"{scene}-{seed}-{defect.name}-{'cured' if cured else 'uncured'}-{self.steps}-{training_seed}"
        about = {"scene": scene, "seed": seed, "defect": defect.name, "cured": cured, "steps": self.steps}
        about |= {"training_seed": training_seed, "against": defect.against}
        usual: dict[str, Any] = {"holdout": HOLDOUT, "steps": self.steps, "budget_s": None, "seed": training_seed}
        config = ReconstructionConfig(**usual | ({} if cured else defect.uncured))

        def measure() -> dict:
            path = recorded(self.work, self.rig, subject, defect)
            if not cured and defect.bent:
                path = straightened(path)
            return apart(partial(_measured, path, self.work / f"{name}.run", config))

        key = code_and_machine() | {"choices": asdict(config)}
        return about | kept(self.work / f"{name}.json", in_time(self.time_left, measure), key)


def bench_defects(
    scenes: Sequence[tuple[str, int]],
    realistic: Sequence[tuple[str, int]],
    work: Path,
    progress: Progress,
    *,
    quick: bool = False,
    time_left: Callable[[], bool] = lambda: True,
) -> BenchDocument:
    """Run every defect on `scenes`, and a few on the `realistic` ones, each a name and a seed.

    `quick`: one defect of the first scene, in few steps. Without `time_left` no further run is begun. Recordings and
    runs lie in a folder of `work` that this code has of its own; a run found there is not repeated, so that a stopped
    bench resumes.
    """
    document, work = BenchDocument("defects"), work.resolve() / this_code()
    work.mkdir(parents=True, exist_ok=True)
    rig, steps = catalog_rig("ci3x3" if quick else "lab3x3"), QUICK_STEPS if quick else STEPS
    shop = Workshop(work, rig, steps, time_left)
    todo = _todo(scenes, [], (replace(CLEAN, seeds=SEEDS[:1]), DEFECTS[0])) if quick else _todo(scenes, realistic)
    for number, (subject, defect, training_seed, cured) in enumerate(todo):
        scene, seed = subject
        progress(number / len(todo), f"{scene}, seed {seed}: {defect.name}, training {training_seed}")
        try:
            document.rows.append(shop.row(subject, defect, training_seed, cured=cured))
        except (AcquisitionError, ReconstructionError) as error:
            document.omissions.append(f"{scene}, {defect.name}: {error}")
    document.omissions = list(dict.fromkeys(document.omissions))
    document.summary = costs(document.rows)
    document.omissions += [
        f"{row['scene']}, {row['defect']}, {'cured' if row['cured'] else 'uncured'}, training {row['training_seed']}: "
        f"refused, {row['refused']}"
        for row in document.rows
        if "refused" in row
    ]
    progress(1.0, f"{len(document.rows)} runs")
    return document


def _todo(
    scenes: Sequence[Subject], realistic: Sequence[Subject], defects: Sequence[Defect] | None = None
) -> list[tuple[Subject, Defect, int, bool]]:
    """Return all runs: subject, defect, seed of the training, and whether it is cured; `defects` None for all.

    Runs without the cure have one seed, and the realistic scenes none of them. Backgrounds are held against nothing.
    """
    plain = replace(CLEAN, seeds=SEEDS[:1])
    pairs = [(one, defect) for one in scenes for defect in defects or (CLEAN, *DEFECTS)]
    pairs += [] if defects else [((scene, DEVELOPMENT_SEEDS[0]), plain) for scene in BACKGROUNDS]
    pairs += [(one, defect) for one in realistic for defect in (CLEAN, *FEW)]
    runs = []
    for subject, defect in pairs:
        runs += [(subject, defect, seed, True) for seed in defect.seeds]
        if defect.curable and subject not in realistic:
            runs.append((subject, defect, defect.seeds[0], False))
    return runs


def costs(rows: Sequence[dict]) -> dict[str, float]:
    """Return what each defect takes from the recording it is held against, with its cure and without, in dB.

    Scores and costs are of means over the seeds of trainings. `cost_spread_db` and `dynamic_cost_spread_db` are the
    ranges of the differences seed by seed, where both recordings have several.
    """
    runs: dict[tuple[str, str, bool], dict[int, dict]] = {}
    for row in rows:
        if "refused" not in row:
            runs.setdefault((row["scene"], row["defect"], row["cured"]), {})[row["training_seed"]] = row
    found: dict[str, float] = {}
    for (scene, name, cured), own in runs.items():
        key, scores = f"{scene}.{name}", means(list(own.values()), SCORES)
        found |= named(key, scores) if cured else {}
        against = next(iter(own.values()))["against"]
        other = runs.get((scene, against, True), {})
        levels = means(list(other.values()), SCORES)
        for score, start in (("psnr_db", ""), ("dynamic_psnr_db", "dynamic_")) if name != against else ():
            start = start if cured else f"uncured_{start}"
            if score in scores and score in levels:
                found[f"{key}.{start}cost_db"] = levels[score] - scores[score]
            both = [(other[seed], own[seed]) for seed in own.keys() & other.keys()]
            gaps = [one[score] - run[score] for one, run in both if score in one and score in run]
            if len(gaps) > 1:
                found[f"{key}.{start}cost_spread_db"] = max(gaps) - min(gaps)
    return found


def _measured(recording: Path, out: Path, config: ReconstructionConfig) -> dict:
    from reconstruction.bench.defects.run import measured  # loads torch, in the process of the run alone

    try:
        return measured(recording, out, config)
    except ReconstructionError as refusal:
        return {"revision": code_revision(), "refused": " ".join(str(refusal).split())}
