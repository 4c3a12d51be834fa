"""Measures what joint training and a pretrained image network buy MSDI: its small tier, trained anew in each way.

All arms take the same steps over the same samples. They are scored on random clips that no training sees, and on the
recordings of development scenes, whose rigs are misplaced alike; the weights that ship stand beside them.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

from acquisition.bench_document import BenchDocument, device
from acquisition.durable import write_durably
from acquisition.progress import Progress, part
from acquisition.revision import code_revision
from acquisition.scenes.misplaced import misplaced
from reconstruction.bench.conventions import in_time, kept, made_by, named
from reconstruction.bench.paper.bench import NOT_RUN, UNPRINTED, lacks_runs
from reconstruction.bench.paper.digest import networks_code
from reconstruction.bench.paper.tables import markdown
from reconstruction.errors import ReconstructionError
from reconstruction.networks.msdi.network import Msdi, trained_msdi
from reconstruction.networks.training import msdi_validation
from reconstruction.networks.training.clips import VIEW_KINDS, MultiviewClips, write_clips
from reconstruction.networks.training.msdi_training import MsdiConfig, MsdiTraining
from reconstruction.networks.training.msdi_validation import RANDOM_ERROR, ScoredViews

MIXTURE = (*("photographs", "clutter") * 9, "photographs", "rooms")  # a room takes as long as twenty others
ARMS: dict[str, dict] = {
    "joint, images pretrained": {},
    "separate, images pretrained": {"joint": False},
    "joint, images from scratch": {"pretrained": False},
}
SHIPPED_ARM, SEED = "shipped", 5
SCORES = {"deg": ".3f", "percent": ".3f", "db": ".1f", "abs_rel": ".4f"}
HEADINGS = ("weights", "scenes", "cameras / degrees", "cameras / %", "images / dB", "Abs Rel", "steps", "seconds")
ABOUT = """The small MSDI, trained anew in three ways by equal steps over the same clips of random scenes, and the
weights that ship, which have learnt for hours ([curve](msdi.png)). *Separate*: geometry does not teach the image
network. *From scratch*: the image network does not start as the small Spk2ImgNet, and learns in every step, where the
others' learns in every fourth of the last three quarters; geometry is pretrained in no row. Scored on random clips that
no training sees, by kind, and on development recordings, all with rigs 2 degrees, 2 cm and 2% off. A step is one
sample, and an arm one seed, so small differences say nothing."""


@dataclass(frozen=True)
class Lengths:
    """The clips to learn from, the steps, the steps between scores, and how many random clips of which kinds score."""

    clips: MultiviewClips = field(default_factory=lambda: MultiviewClips(2000, 300, kinds=MIXTURE))
    steps: int = 2000
    score_every: int = 1000
    scored: int = 18
    kinds: tuple[str, ...] = VIEW_KINDS


QUICK = Lengths(MultiviewClips(2000, 2, 3, 56, 40), steps=2, score_every=2, scored=1, kinds=("clutter",))


def bench_msdi(
    recordings: Sequence[Path],
    work: Path,
    progress: Progress,
    *,
    quick: bool = False,
    time_left: Callable[[], bool] = lambda: True,
) -> BenchDocument:
    """Train every arm in `work`, where a stopped bench resumes, and score it there and on simulated `recordings`.

    Without `time_left` no further arm is begun, and those that were trained before are told.
    """
    lengths, code = QUICK if quick else Lengths(), networks_code()
    document, clips = BenchDocument("msdi"), work / f"clips-{code}"
    write_clips(clips, lengths.clips, part(progress, 0, 0.1))
    random = msdi_validation.random_clips(lengths.kinds, lengths.scored)
    views = msdi_validation.scored_views(random, recordings, part(progress, 0.1, 0.2))
    scored = [misplaced_views(one, SEED + number) for number, one in enumerate(views)]
    for number, (arm, choices) in enumerate(ARMS.items()):
        along = part(progress, 0.2 + 0.8 * number / len(ARMS), 0.2 + 0.8 * (number + 1) / len(ARMS))
        folder = work / f"{_folder(arm)}-{code}"  # a training goes on by the code that it began with
        learn = partial(_learnt, arm, folder, clips, lengths, scored, along)
        key = choices | {"steps": lengths.steps, "networks": code, "rigs_off": RANDOM_ERROR}
        try:
            document.rows += kept(work / f"{_folder(arm)}.json", in_time(time_left, learn), key)["rows"]
        except ReconstructionError as error:
            document.omissions.append(f"{arm}: {NOT_RUN}, {error}")
    shipped = msdi_validation.scores_by_scene(trained_msdi(), scored)
    document.rows += [{"arm": SHIPPED_ARM, "scene": scene, **scores} for scene, scores in shipped.items()]
    for row in document.rows:
        document.summary |= named(f"{row['arm']}.{row['scene']}", {score: row[score] for score in SCORES})
    document.omissions.append("one seed an arm; the large tier; geometry that begins as DUSt3R")
    return document


def misplaced_views(one: ScoredViews, seed: int) -> ScoredViews:
    """Return the views of a development recording with a rig as far off as those of random clips, which stay as is."""
    return one if one.part == "random" else replace(one, nominal=misplaced(one.nominal, RANDOM_ERROR, seed))


def _learnt(
    arm: str, folder: Path, clips: Path, lengths: Lengths, scored: Sequence[ScoredViews], progress: Progress
) -> dict:
    """Train an arm to its end in `folder` and return its rows, one a scene at every score on the way."""
    length = {"steps": lengths.steps, "image_from": lengths.steps // 4, "pose_from": lengths.steps // 10}
    config = MsdiConfig("small", score_every=lengths.score_every, seed=SEED, **length, **ARMS[arm])
    training = MsdiTraining(folder, config, clips, "cpu", {})

    def score(network: Msdi) -> dict[str, float]:
        found = msdi_validation.scores_by_scene(network, scored)
        return {f"{scene} {name}": value for scene, scores in found.items() for name, value in scores.items()}

    training.run(score, lambda share, message: progress(share, f"{arm}: {message}"))
    scenes = dict.fromkeys(one.scene for one in scored)
    about = {"arm": arm, "revision": code_revision(), **device()}
    rows = [
        about
        | {"scene": scene, "steps": point["step"], "seconds": point["seconds"]}
        | {name: point[f"{scene} {name}"] for name in SCORES}
        for point in training.curve
        for scene in scenes
    ]
    return {"rows": rows}


def _folder(arm: str) -> str:
    return arm.replace(", ", "-").replace(" ", "-")


def write_page(path: Path, document: dict) -> None:
    """Write the page of a document of this bench; its table only where every arm has been trained."""
    lines = []
    for row in document["rows"]:
        took = (f"{row['steps']:,}", f"{row['seconds']:.0f}") if "steps" in row else ("", "")
        lines.append([row["arm"], row["scene"], *(format(row[score], form) for score, form in SCORES.items()), *took])
    table = UNPRINTED if lacks_runs(document["omissions"]) else markdown(HEADINGS, lines)
    about = ABOUT.replace("\n", " ")
    write_durably(path, "\n\n".join(("# MSDI", made_by(document), about, table)).encode() + b"\n")
