"""Measures SPSS, the loss of Spike4DGS, on recorded spikes: beside the pixel loss, by weight, at equal steps and time.

The loss compares how rendered and recorded spikes change. In a row with a weight, it comes to the loss on images in
every second step. In a row where it is alone, it takes the place of that loss there, as in the paper's chain.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from acquisition.bench_document import BenchDocument
from acquisition.durable import write_durably
from acquisition.progress import Progress
from acquisition.scenes.catalog import DEVELOPMENT, REALISTIC
from reconstruction.bench.conventions import made_by, means, named
from reconstruction.bench.paper import methods as m
from reconstruction.bench.paper.bench import UNPRINTED, lacks_runs, run_protocol
from reconstruction.bench.paper.method import Batch, Effort, Method, Protocol, Row, Table
from reconstruction.bench.paper.run import Laboratory
from reconstruction.bench.paper.tables import markdown
from reconstruction.bench.variance_shares import variance_shares
from rigs.rig import Rig

WEIGHTS = (0.1, 0.01, 1.0, 10.0)
BASES = (m.AUTO, m.TFI["4dgs-small"])
SCENES = (*DEVELOPMENT, *REALISTIC[1:])  # with things that move
EFFORTS, QUICK_EFFORTS = (Effort(steps=1000), Effort(60.0)), (Effort(steps=20),)
SCORES = ("psnr_db", "dynamic_psnr_db", "abs_rel", "steps_per_s")
SHOWN = {
    **{"psnr_db": ".2f", "dynamic_psnr_db": ".2f", "gain.psnr_db": "+.2f", "gain.dynamic_psnr_db": "+.2f"},
    **{"abs_rel": ".4f", "steps_per_s": ".0f", "scenes": ".0f"},
}
PARTS = {"spikes2": ".2f", "motion": ".0%", "counting": ".0%", "noise": ".0%"}
COLUMNS = ("row", "at", "PSNR / dB", "movers / dB", "to the same without", "movers", "Abs Rel", "steps / s", "scenes")
ABOUT = """Development scenes, the second seed of each. With a weight, every second step has the loss on images and, by
the weight, the spike loss (SPSS as we read it, decision 151), and the others the loss on images alone. `+spss-alone`:
every second step has the spike loss alone, as in the chain of the paper's tables. Differences are means over the scenes
that both rows have."""
SHARES = """The loss sees the variance of how counts differ from window to window; here it is that of a clip of
`fan_and_ball`. *Motion* is that of true charges, *counting* what whole spikes of an unknown phase add, *noise* the
rest."""


def spss_protocol(scenes: tuple[str, ...] = SCENES, *, quick: bool = False) -> Protocol:
    """Return the runs of the bench: each base without the loss, then by weight, at each effort.

    The loss alone in its steps comes last, at equal steps.
    """
    weights, efforts = (WEIGHTS[:1], QUICK_EFFORTS) if quick else (WEIGHTS, EFFORTS)
    methods = [*BASES, *(weighted(base, weight) for weight in weights for base in BASES)]
    others = [] if quick else [alone(base) for base in BASES]
    table = Table("spss", "SPSS", "", tuple(Row(method.name, method) for method in (*methods, *others)))
    kinds = ((methods, efforts), (others, efforts[:1]))
    batches = [
        Batch("spss", (scene,), lengths, tuple(method.name for method in some))
        for some, lengths in kinds
        for scene in (scenes if some else ())
    ]
    return Protocol((table,), tuple(batches))


def weighted(base: Method, weight: float) -> Method:
    """Return a method with SPSS beside its loss on images."""
    return base.changed(f"{base.name}+spss@{weight:g}", supervision="variation", spike_weight=weight)


def alone(base: Method) -> Method:
    """Return a method with SPSS in place of its loss on images in every second step."""
    return base.changed(f"{base.name}+spss-alone", supervision="variation")


def bench_spss(
    protocol: Protocol, laboratory: Laboratory, rig: Rig, progress: Progress, time_left: Callable[[], bool]
) -> BenchDocument:
    """Run the protocol and return its rows; the summary has means, and differences to the base over shared scenes.

    It also has the shares of motion, counting and noise in the recorded variance, by a clip of cameras like `rig`.
    """
    document = run_protocol("spss", protocol, laboratory, progress, time_left)
    for name, effort in dict.fromkeys((row["method"], row["effort"]) for row in document.rows):
        own = {row["scene"]: row for row in document.rows if (row["method"], row["effort"]) == (name, effort)}
        found = means(list(own.values()), SCORES) | {"scenes": float(len(own))}
        base = name.partition("+spss")[0]
        beside = {row["scene"]: row for row in document.rows if (row["method"], row["effort"]) == (base, effort)}
        both = own.keys() & beside.keys() if base != name else set()
        for score in SCORES[:2] if both else ():
            found[f"gain.{score}"] = float(
                np.mean([own[scene][score] - beside[scene][score] for scene in sorted(both)])
            )
        document.summary |= named(name, found, f"@{effort}")
    document.summary |= variance_shares(rig)
    document.omissions.append("one seed a scene; the window's length and stride as in decision 151")
    return document


def write_page(path: Path, document: dict) -> None:
    """Write the page of a document of this bench; its table only where no run is left to be made."""
    summary, lines = document["summary"], []
    for name, effort in dict.fromkeys((row["method"], row["effort"]) for row in document["rows"]):
        found = (summary.get(f"{name}.{score}@{effort}") for score in SHOWN)
        shown = (
            "" if value is None else format(value, form) for value, form in zip(found, SHOWN.values(), strict=True)
        )
        lines.append([name, effort, *shown])
    table = UNPRINTED if lacks_runs(document["omissions"]) else markdown(COLUMNS, lines)
    parts = ("# SPSS", made_by(document), ABOUT.replace("\n", " "), table, SHARES.replace("\n", " "), _shares(summary))
    write_durably(path, "\n\n".join(parts).encode() + b"\n")


def _shares(summary: dict) -> str:
    """Return the table of the shares of the recorded variance."""
    told = (
        [part, *(format(summary[f"variance.{part}.{name}"], form) for name, form in PARTS.items())]
        for part in ("movers", "still")
    )
    return markdown(("pixels", "variance / spikes^2", "motion", "counting", "noise"), list(told))
