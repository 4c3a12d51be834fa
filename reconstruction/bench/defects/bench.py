"""Measures what each defect of real cameras and real light costs, alone and all together, with its cure and without.

All runs take the same steps and are scored on the centre camera. `cost_db` is what a defect takes from the clean
recording of the same scene, or from the one by the same misplaced cameras whose rig file says where they are (`built`).
`uncured_cost_db` is what it takes where its cure is switched off.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from acquisition.bench_document import BenchDocument
from acquisition.errors import AcquisitionError
from acquisition.progress import Progress
from acquisition.scenes.catalog import BACKGROUNDS, DEVELOPMENT_SEEDS
from acquisition.scenes.glass import Glass
from acquisition.spikes.traits import Traits
from reconstruction.bench.conventions import HOLDOUT, apart, kept
from reconstruction.bench.defects.recordings import Defect, recorded, straightened
from reconstruction.errors import ReconstructionError
from reconstruction.run.configuration import ReconstructionConfig
from rigs.rig import Rig
from rigs.toml import catalog_rig

STEPS, QUICK_STEPS = 600, 20
OFF = 2.0  # degrees, cm and percent that a nominal rig is off
SCORES = ("psnr_db", "dynamic_psnr_db", "abs_rel", "rotation_deg", "focal_percent")


CLEAN = Defect("clean")
SPREAD = Traits(pixel_spread=0.03)
BLIND = {"pixels": "even", "gains": "off"}
NINE = {"window": 9}
RIG_OFF = Defect("rig-off", {"rig_error": OFF}, uncured={"init": "sweep"}, against="built")
BUILT = Defect("built", told=RIG_OFF)
TOGETHER = Defect(
    "together",
    {"traits": SPREAD, "camera_gains": 0.05, "camera_lags": 1.0, "rig_error": OFF},
    bent=True,
    maps=True,
    uncured=BLIND,
    against="built",
)
DEFECTS = (
    Defect("lens", bent=True),
    Defect("pixels", {"traits": SPREAD}, maps=True, uncured={"pixels": "even"}),
    Defect("vignetting", {"glass": Glass(vignetting=0.3)}, maps=True, uncured={"pixels": "even"}),
    Defect("blur", {"glass": Glass(blur=0.5)}),
    Defect("gains", {"camera_gains": 0.05}, uncured={"gains": "off"}),
    Defect("lags", {"camera_lags": 1.0}, uncured={"gains": "off"}),
    Defect("harsh", {"sensor": "harsh"}, maps=True, uncured={"pixels": "even"}),
    BUILT,
    RIG_OFF,
    TOGETHER,
    Defect("10-khz", rate_hz=10000, uncured=NINE),
    Defect("5-khz", rate_hz=5000, uncured=NINE),
    Defect("2-khz", rate_hz=2000, uncured=NINE),
    Defect("tenth-light", {"light": 0.1}, uncured=NINE),
    Defect("hundredth-light", {"light": 0.01}, uncured=NINE),
)
FEW = (BUILT, RIG_OFF, TOGETHER)  # on the realistic scenes


@dataclass(frozen=True)
class Workshop:
    """The folder of recordings and runs, the rig, and the length of the runs in steps."""

    work: Path
    rig: Rig
    steps: int = STEPS

    def row(self, scene: str, seed: int, defect: Defect, *, cured: bool = True) -> dict:
        """Return the run of a scene with a defect, with its cure or without: measured now, or found in `work`."""
        name = f"{scene}-{seed}-{defect.name}-{'cured' if cured else 'uncured'}-{self.steps}"
        about = {"scene": scene, "seed": seed, "defect": defect.name, "cured": cured, "steps": self.steps}

        def measure() -> dict:
            path = recorded(self.work, self.rig, (scene, seed), defect)
            if not cured and defect.bent:
                path = straightened(path)
            choices = {} if cured else defect.uncured
            config = ReconstructionConfig(holdout=HOLDOUT, steps=self.steps, budget_s=None, **choices)
            return apart(partial(_measured, path, self.work / f"{name}.run", config))

        return about | kept(self.work / f"{name}.json", measure)


def bench_defects(
    scenes: Sequence[tuple[str, int]],
    realistic: Sequence[tuple[str, int]],
    work: Path,
    progress: Progress,
    *,
    quick: bool = False,
    time_left: Callable[[], bool] = lambda: True,
) -> BenchDocument:
    """Run every defect on `scenes`, and a few on the `realistic` ones, each a name and a seed; runs lie in `work`.

    `quick`: one defect of the first scene, in few steps. Without `time_left` no further run is begun. A run found in
    `work` is not repeated, so that a stopped bench resumes.
    """
    document, work = BenchDocument("defects"), work.resolve()
    work.mkdir(parents=True, exist_ok=True)
    shop = Workshop(work, catalog_rig("ci3x3" if quick else "lab3x3"), QUICK_STEPS if quick else STEPS)
    todo = [(*one, defect) for one in scenes for defect in (CLEAN, *(DEFECTS[:1] if quick else DEFECTS))]
    todo += [] if quick else [(scene, DEVELOPMENT_SEEDS[0], CLEAN) for scene in BACKGROUNDS]
    todo += [] if quick else [(*one, defect) for one in realistic for defect in (CLEAN, *FEW)]
    for number, (scene, seed, defect) in enumerate(todo):
        if not time_left():
            document.omissions.append(f"{scene}, {defect.name}: no time was left")
            continue
        progress(number / len(todo), f"{scene}, seed {seed}: {defect.name}")
        try:
            document.rows.append(shop.row(scene, seed, defect))
            if defect.curable and (scene, seed) not in realistic:
                document.rows.append(shop.row(scene, seed, defect, cured=False))
        except AcquisitionError as error:
            document.omissions.append(f"{scene}, {defect.name}: {error}")
    document.summary = costs(document.rows)
    document.omissions += [
        f"{row['scene']}, {row['defect']}, {'cured' if row['cured'] else 'uncured'}: refused, {row['refused']}"
        for row in document.rows
        if "refused" in row
    ]
    progress(1.0, f"{len(document.rows)} runs")
    return document


def costs(rows: Sequence[dict]) -> dict[str, float]:
    """Return what each defect takes from the recording it is held against, with its cure and without, in dB."""
    good = [row for row in rows if "refused" not in row]
    cured = {(row["scene"], row["defect"]): row for row in good if row["cured"]}
    against = {defect.name: defect.against for defect in (*DEFECTS, *FEW)}
    found: dict[str, float] = {}
    for row in good:
        key, own = f"{row['scene']}.{row['defect']}", cured.get((row["scene"], against.get(row["defect"], CLEAN.name)))
        if row["cured"]:
            found |= {f"{key}.{name}": row[name] for name in SCORES if name in row}
        if row["defect"] == CLEAN.name:
            continue
        if own is None:
            continue
        start = "" if row["cured"] else "uncured_"
        for score, name in (("psnr_db", "cost_db"), ("dynamic_psnr_db", "dynamic_cost_db")):
            if score in row and score in own:
                found[f"{key}.{start}{name}"] = own[score] - row[score]
    return found


def _measured(recording: Path, out: Path, config: ReconstructionConfig) -> dict:
    from reconstruction.bench.defects.run import measured  # loads torch, in the process of the run alone

    try:
        return measured(recording, out, config)
    except ReconstructionError as refusal:
        return {"refused": " ".join(str(refusal).split())}
