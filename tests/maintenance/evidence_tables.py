"""Writes the tables of single documents as Markdown pages: what was measured, with which code, on which machine."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence

from maintenance.beside_the_paper import BESIDE, paper_table

from acquisition.bench_document import revisions_of
from reconstruction.bench.conventions import means
from reconstruction.bench.paper.tables import markdown

COMMANDS = {
    "axe": "make axe",
    "faults": "make faults",
    "gpu": "make gpu",
    "service_load": "make load",
    "sharing": "make sharing",
    "stability": "spike4dgs stability --full",
}
ABOUT = {
    "axe": "Every state of the pages, dialogs and the viewer among them, 1280 and 400 pixels wide, light and dark, by "
    "axe-core's rules. The figures count findings by their impact.",
    "compact": "Planes compressed without loss, of all cameras, on one core; MB of planes a second of the processor. "
    "`histsflow_car` and `zoo_uhsr` are real, `zoo_data_200_part1` is of another simulator, the others are ours. "
    "`plane_ms`: a single plane, with the block that holds it. `trains, zstd 7` is what `compact` writes; the other "
    "ways are of the first block of each recording's middle camera: `planes` as they are, `differences` from plane to "
    "plane, `trains` of single pixels. Means are harmonic.",
    "defects": "The development scenes at equal steps. `cost_db`: what a defect takes from the clean recording of the "
    "same scene, over the whole picture and over movers; `uncured_`: without the cure. `built`: cameras 2 degrees off "
    "the drawing, whose rig file knows it; the costs of `rig-off`, which must find it, count from there, and those of "
    "`together` from `built-bent-with-maps`, which has its lenses and maps of its pixels, too. Those of `pixels`, "
    "`vignetting` and `harsh` count from `clean-maps`; without their cure they have no maps. `together`: 10% barrel, "
    "3% pixel spread, 5% camera gains, lags of a plane, and a rig 2 degrees off. Costs are of means over the seeds of "
    "trainings, `cost_spread_db` the range of the differences seed by seed. Older rows, which name no seed of a "
    "training, are one run each, held against recordings without maps and bent lenses; `uncured_` of their `together` "
    "finds its lens all the same.",
    "faults": "Rounds of a real web process with two workers, jobs that sleep, and captures by the real recorder on "
    "simulated cameras, while processes are killed with kill -9 and clients cancel, resume, restart, stop, save and "
    "finalise; both databases side by side. `lost`: accepted and gone; `undone`: never ended; `repeated`: ended work "
    "done again; `reopened`: a finished stage begun again; `torn`: half-written under a final name; `broken`: rounds "
    "that did not come to their end. Of captures, `doubled`: begun twice; `false_complete`: called whole and is not; "
    "`altered`: other planes than the killed recorder had on the disk (`cut_off` were compared); `hidden`: kept planes "
    "that the service does not tell of; `unexplained`: no reason given. `failed` ones kept no plane.",
    "gpu": "gsplat on a CUDA device beside the native renderer on the processor: trained for equal steps and for equal "
    "time, timed on random clouds at 400x250, and held against one another on one trained cloud. Differences of "
    "gradients are shares of the largest.",
    "images": "The evaluation scenes, centre camera, 400x250, real sensor, three instants each; PSNR and SSIM against "
    "the exact light. `@light`: factors of the scene's light; `@drop` and `@reintegrate`: planes a second.",
    "leave-out": "200x125, 400 steps, as many Gaussians as the plan chooses. Positive costs are what the plan loses "
    "against the other run; `saves` is what the other run takes more. `every choice switched` has straight paths for "
    "all pixels, poses searched and refined, gains, adaptive images at every plane, and image variation: an engine "
    "that does not look at the scene, and no bound of what a plan could reach.",
    "pixels": "A still picture by a centre camera whose pixels were calibrated from a flat and a dark recording.",
    "poses": "The rig as drawn is the true one misplaced by about 2 degrees, 2 cm and 2% of the focal length. Errors "
    "are after similarity alignment; refused runs are not in the means. `nominal`, `views`, `planes` with a number: "
    "rigs off by so many degrees, so many views, so many planes. `natural.trial` starts from 20 random rigs a scene.",
    "rasterizer": "Random clouds; intensity, depth and alpha on one thread, a whole step on two. `_of_limit`: time of "
    "the useful arithmetic alone over the time taken.",
    "recorder": "A byte source faster than the disk through the real rings and writers, with hashing; the parser on "
    "one core.",
    "service_load": "200 clients of one request a second each for a minute, 1,000 jobs queued, clients, service and a "
    "busy stage on the same two cores.",
    "sharing": "More workers on a long recording, over the seconds of one. `worked`: 4,000 planes of `carried_boxes`, "
    "2,000 steps for each span, by workers that have one core each. `played`: the tasks of 20,000 planes sleep for as "
    "long as they took in `bench long`; queue, workers and database are real, all on two cores; "
    "`least`: what no schedule of these tasks is below.",
    "stability": "`rows` is the number of backends, methods or models that a case ran on.",
    "training": "Budgets are wall seconds to the last checkpoint, images and points included, in a process that has "
    "loaded its libraries; true poses. `auto` is a mean over evaluation scenes; `model.*` and `supervision.*` change "
    "one choice on the development scene, so that `model.bases` is what they are to be held against.",
    "viewpoints": "The paper bench's runs of a minute from where no camera stood: along the middle row of the array, "
    "outwards from a corner camera, towards the scene and away from it. Cameras stand at -0.2, 0 and 0.2 m.",
}
NUMBERED = re.compile(r"(?P<row>.+)\.(?P<score>[a-z][a-z_0-9]*)(?P<at>@.+)?")
SMALL = re.compile(r"(?<![\w-])(spk2imgnet|msdi-image|msdi)(?![\w-])")
LEAST_ROWS = 3  # rows that must have a score for it to be a column
MOST_PLACES = 6  # values behind an @ that may stand in the rows' names
VIEWPOINT_SCORES = (("psnr_db", ".1f"), ("dynamic_psnr_db", ".1f"), ("abs_rel", ".4f"), ("empty", ".3f"))
LEFT_OUT_SCORES = (
    ("saved_s", ".1f"),
    ("claimed_s", ".1f"),
    ("saved_mb", ".0f"),
    ("claimed_mb", ".1f"),
    ("cost_db", "+.2f"),
    ("dynamic_cost_db", "+.2f"),
)


def page(name: str, document: dict) -> str:
    """Return the page of a document: its head, its own tables, its summary and its omissions."""
    device, rows = document["device"], document["rows"]
    command = COMMANDS.get(name, f"spike4dgs bench {name}")
    head = f"`{command}`, revision {document['revision']}, {device['processor']}, "
    accelerator = device.get("accelerator") or ""
    head += f"{device['threads']} threads{accelerator and f', {accelerator}'}; "
    older = revisions_of(document, rows) != revisions_of(document, [])
    head += f"rows of {revisions_of(document, rows)}; " if older else ""
    head += f"drawn from [{name}.json]({name}.json) by `make evidence`."
    parts = [f"# {name.capitalize().replace('_', ' ')}", head, ABOUT[name]]
    parts += [paper_table(name, document)] if name in BESIDE else []
    parts += [TABLES[name](document)] if name in TABLES else _summary(document["summary"])
    if document["omissions"]:
        parts += ["## Omissions", "\n".join(f"- {line}" for line in document["omissions"])]
    return "\n\n".join(parts) + "\n"


def _summary(summary: Mapping[str, float]) -> list[str]:
    """Return scores that several rows have as tables of these rows, and the other names line by line.

    Where a score has many values behind an @ (lights, plane rates), these are the columns of a table of their own.
    """
    split = {key: match for key in summary if (match := NUMBERED.fullmatch(key))}
    places = list(dict.fromkeys(match["at"] for match in split.values() if match["at"]))
    plain, swept = {}, {}
    for key, match in split.items():
        label, value = SMALL.sub(r"small \1", match["row"]), f"{summary[key]:.5g}"
        if match["at"] and len(places) > MOST_PLACES:
            swept.setdefault(f"{label}, {match['score']}", {})[match["at"]] = value
        else:
            plain.setdefault(f"{label} {match['at'] or ''}".strip(), {})[match["score"]] = value
    counts = [score for found in plain.values() for score in found]
    scores = [score for score in dict.fromkeys(counts) if counts.count(score) >= LEAST_ROWS]
    tabled = {label: found for label, found in plain.items() if set(found) & set(scores)}
    shown = {key for key, match in split.items() if match["score"] in scores}
    rest = {key: value for key, value in summary.items() if key not in shown}
    tables = [_grid(tabled, scores), _grid(swept, places)]
    lines = [[key, f"{value:.5g}"] for key, value in rest.items()]
    return [t for t in (*tables, markdown(("figure", "value"), lines) if lines else "") if t]


def _grid(rows: Mapping[str, Mapping[str, str]], columns: Sequence[str]) -> str:
    """Return a table of the rows that have one of the columns; empty where there is none."""
    lines = [[label, *(found.get(column, "") for column in columns)] for label, found in rows.items()]
    return markdown(("", *columns), lines) if lines else ""


def _viewpoints(document: dict) -> str:
    """Return means over the scenes at each place, and the worst of them."""
    rows, lines = document["rows"], []
    for line, along_m in dict.fromkeys((r["line"], r["along_m"]) for r in rows):
        own = [r for r in rows if (r["line"], r["along_m"]) == (line, along_m)]
        level, *figures = [_mean(own, score, form) for score, form in VIEWPOINT_SCORES]
        worst = f"{min(r['psnr_db'] for r in own):.1f}"
        lines.append([line, f"{along_m:+.2f}", f"{own[0]['distance_m']:.2f}", level, worst, *figures])
    columns = ("line", "along / m", "nearest camera / m", "PSNR / dB", "worst / dB", "movers / dB", "Abs Rel", "empty")
    return markdown(columns, lines)


def _mean(rows: Sequence[dict], score: str, form: str) -> str:
    found = means(rows, (score,))
    return format(found[score], form) if found else ""


def _cases(document: dict) -> str:
    """Return each case with its number of backends, its worst errors, and the backends that failed."""
    rows, lines = document["rows"], []
    for case in dict.fromkeys(row["case"] for row in rows):
        own = [row for row in rows if row["case"] == case]
        worst = [max((r[k] for r in own if r.get(k) is not None), default=None) for k in ("error", "gradient")]
        errors = ["-" if w is None else f"{w:.1e}" for w in worst]
        failed = ", ".join(r["backend"] for r in own if r["verdict"] == "fail")
        lines.append([case, own[0]["expected"], str(len(own)), *errors, f"fail: {failed}" if failed else "pass"])
    return markdown(("case", "expected", "rows", "worst error", "worst gradient", "verdict"), lines)


def _left_out(document: dict) -> str:
    """Return each case, and each decision of it, at equal steps: what the plan saves and what it costs."""
    summary, lines = document["summary"], []
    for key in (key.removesuffix(".saved_s") for key in summary if key.endswith(".saved_s")):
        case, _, decision = key.partition(".")
        values = [(summary.get(f"{key}.{name}"), form) for name, form in LEFT_OUT_SCORES]
        lines.append(
            [case, decision or "every choice switched", *("" if v is None else format(v, form) for v, form in values)]
        )
    columns = ("case", "against", "saves / s", "claims / s", "saves / MB", "claims / MB", "costs / dB", "movers / dB")
    missed = [[key, f"{value:.5g}"] for key, value in summary.items() if key.startswith("missed-mover")]
    about = "A plan that is wrong: `faint` has a mover that the plan takes for still, and the watch undoes it."
    return "\n\n".join([markdown(columns, lines), about, markdown(("figure", "value"), missed)])


TABLES: Mapping[str, Callable[[dict], str]] = {"viewpoints": _viewpoints, "stability": _cases, "leave-out": _left_out}
