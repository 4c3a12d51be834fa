"""Tells apart why a longer training may end worse: noise learnt by heart, or geometry that fits too few views.

Each arm takes one cause away and is trained for 3,000 and for 12,000 steps: a budget of seconds would end where more
steps are known to gain nothing. Clean and blurred images stand at every 20th plane, where the score is taken, and spike
images at every fourth. The arm that has those at every 20th plane has as many as there are clean ones, half way between
them: noise is the cause that is left. What is lost by both is not noise. What the ideal sensor loses is the rounding to
whole spikes; what the real one loses beside it is noise and the fixed pattern of its pixels. Fewer views show whether
geometry that fits only them is at work. The last arm holds out another camera, and never sees the usual one: does a
training camera that is left out tell the same?
"""

from collections.abc import Callable, Mapping
from pathlib import Path

from acquisition.bench_document import BenchDocument
from acquisition.durable import write_durably
from acquisition.progress import Progress
from acquisition.scenes.catalog import DEVELOPMENT, REALISTIC
from acquisition.scenes.truth import EVERY
from acquisition.spikes.sensor import SensorKind
from reconstruction.bench.conventions import VIEWS, made_by, named
from reconstruction.bench.paper import methods as m
from reconstruction.bench.paper.bench import run_protocol
from reconstruction.bench.paper.method import Batch, Effort, Method, Protocol, Row, Table
from reconstruction.bench.paper.run import Laboratory
from reconstruction.bench.paper.tables import markdown

EFFORTS = (Effort(steps=3000), Effort(steps=12_000))
QUICK_EFFORTS = (Effort(steps=20), Effort(steps=40))
SCENES = (*DEVELOPMENT, *REALISTIC)
JUDGE = VIEWS[0]  # the camera that the last arm holds out
FEWER = 5
SPARSE = f"spike images at every {EVERY}th plane"  # as many as there are clean ones
ARMS: dict[str, tuple[SensorKind, Method]] = {
    "as it is": ("real", m.AUTO),
    SPARSE: ("real", m.AUTO.changed("every-20", tick_stride=EVERY)),
    "ideal sensor": ("ideal", Method("ideal-sensor")),
    "blurred images": ("real", m.BLURRED),
    "clean images": ("real", m.CLEAN),
    f"{FEWER} views": ("real", m.seeing(m.AUTO, FEWER)),
    f"clean images, {FEWER} views": ("real", m.seeing(m.CLEAN, FEWER)),
    "judged by a training camera": ("real", Method("judged", {"holdout": JUDGE, "views": VIEWS[1:]})),
}
SCORES = ("psnr_db", "dynamic_psnr_db", "abs_rel")
FORMS = (".2f", ".2f", ".4f")


def longer_protocol(scenes: tuple[str, ...], sensor: SensorKind, *, quick: bool = False) -> Protocol:
    """Return the runs of the arms that see the spikes of this kind of sensor."""
    methods = tuple(method for kind, method in ARMS.values() if kind == sensor)
    table = Table("longer", "Longer training", "", tuple(Row(method.name, method) for method in methods))
    names = tuple(method.name for method in (methods[:1] if quick else methods))
    efforts = QUICK_EFFORTS if quick else EFFORTS
    return Protocol((table,), tuple(Batch("longer", (scene,), efforts, names) for scene in scenes))


def bench_longer(
    laboratories: Mapping[SensorKind, Laboratory],
    scenes: tuple[str, ...],
    progress: Progress,
    time_left: Callable[[], bool],
    *,
    quick: bool = False,
) -> BenchDocument:
    """Run all arms on one scene after the other; the summary has how far each longer run ends above the shorter one.

    `laboratories` have the recordings of each kind of sensor.
    """
    document = BenchDocument("longer")
    for scene in scenes:
        for sensor, laboratory in laboratories.items():
            protocol = longer_protocol((scene,), sensor, quick=quick)
            found = run_protocol("longer", protocol, laboratory, progress, time_left)
            document.rows += found.rows
            document.omissions += found.omissions
    for (scene, name), (short, long) in _pairs(document.rows).items():
        more = {score: long[score] - short[score] for score in SCORES if score in short and score in long}
        document.summary |= named(f"{scene}.{name}.longer", more)
    document.omissions.append("one run a length")
    return document


def write_page(path: Path, document: dict) -> None:
    """Write the page of a document of this bench."""
    about = " ".join((__doc__ or "").partition("\n\n")[2].split())
    labels = {method.name: label for label, (_, method) in ARMS.items()}
    lines = []
    for (scene, name), pair in _pairs(document["rows"]).items():
        more = {score: document["summary"].get(f"{scene}.{name}.longer.{score}") for score in SCORES}
        ends = [cell for row in pair for cell in _cells(row)]
        lines.append([scene, labels[name], *ends, *_cells(more, "+")])
    columns = ["scene", "arm"]
    columns += [f"{name}, {effort}" for effort in ("shorter", "longer") for name in ("PSNR / dB", "movers", "Abs Rel")]
    columns += ["longer - shorter / dB", "movers", "Abs Rel"]
    parts = ["# Longer training", made_by(document), about, markdown(columns, lines)]
    shown = {line[1] for line in lines}
    lacking = [label for label in labels.values() if label not in shown]
    parts += [f"No row has yet: {', '.join(lacking)}."] if lacking else []
    write_durably(path, "\n\n".join(parts).encode() + b"\n")


def _cells(scores: Mapping[str, float | None], sign: str = "") -> list[str]:
    """Return the scores as texts; empty where there is none."""
    found = [scores.get(score) for score in SCORES]
    return ["" if value is None else format(value, sign + form) for value, form in zip(found, FORMS, strict=True)]


def _pairs(rows: list[dict]) -> dict[tuple[str, str], tuple[dict, dict]]:
    """Return the shorter and the longer run of every scene and method that has both."""
    found: dict[tuple[str, str], list[dict]] = {}
    for row in rows:
        found.setdefault((row["scene"], row["method"]), []).append(row)
    return {key: (own[0], own[1]) for key, own in found.items() if len(own) == 2}
