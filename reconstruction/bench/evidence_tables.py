"""The tables that EVIDENCE.md takes from whole documents, as Markdown: by document, then by the name of a block."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from reconstruction.bench.paper.others import IMAGE_ROWS, POSE_ROWS
from reconstruction.bench.paper.protocol import PROTOCOL, STRESSES
from reconstruction.bench.paper.summary import name_of, ordinary
from reconstruction.bench.paper.tables import markdown, measured_table, other_table, time_table
from reconstruction.errors import BadRunError

Documents = Mapping[str, dict]
LATE = "no time was left"
VIEWPOINT_SCORES = (("psnr_db", ".1f"), ("dynamic_psnr_db", ".1f"), ("abs_rel", ".4f"), ("empty", ".3f"))
LEFT_OUT_SCORES = (
    ("saved_s", ".1f"),
    ("claimed_s", ".1f"),
    ("saved_mb", ".0f"),
    ("claimed_mb", ".1f"),
    ("cost_db", "+.2f"),
    ("dynamic_cost_db", "+.2f"),
)


def table(documents: Documents, name: str, block: str) -> str:
    """The block of the document `name`; raises BadRunError where there is no such block."""
    makers = TABLES.get(name, {})
    if block not in makers:
        raise BadRunError(
            f"found the block {name} {block}", f"one of {', '.join(makers) or 'none'}", where="EVIDENCE.md"
        )
    return makers[block](documents)


def _measured(block: str) -> Callable[[Documents], str]:
    found = next(t for t in PROTOCOL.tables if t.name == block)
    return lambda documents: _body(measured_table(found, PROTOCOL, documents["paper"]["rows"]))


def _body(section: str) -> str:
    """A section without its heading: the document has its own."""
    return section.partition("\n\n")[2]


def _scenes(documents: Documents) -> str:
    """Every scene of the table `stress` by itself."""
    (row,) = STRESSES.rows
    names = {cell.name for cell in PROTOCOL.wanted(STRESSES, row)}
    scores = (("psnr_db", ".2f"), ("dynamic_psnr_db", ".2f"), ("ssim", ".3f"), ("abs_rel", ".4f"), ("seconds", ".1f"))
    own = [found for found in documents["paper"]["rows"] if name_of(found) in names]
    lines = [[found["scene"], found["model"], *(_mean([found], *score) for score in scores)] for found in own]
    columns = ("scene", "model chosen", "PSNR / dB", "movers / dB", "SSIM", "Abs Rel", "seconds")
    return markdown(columns, lines)


def _omissions(documents: Documents) -> str:
    """All of them, but those for lack of time in one line: `paper.md` has each."""
    lines = documents["paper"]["omissions"]
    late = [line for line in lines if LATE in line]
    tables = ", ".join(dict.fromkeys(line.partition(",")[0] for line in late))
    told = [line for line in lines if LATE not in line]
    return "\n".join(f"- {line}" for line in [*told, f"{LATE} for {len(late)} rows of {tables}; paper.md names them"])


def _viewpoints(documents: Documents) -> str:
    """Means over the scenes at each place, and the worst of them."""
    rows = documents["viewpoints"]["rows"]
    lines = []
    for line, along_m in dict.fromkeys((r["line"], r["along_m"]) for r in rows):
        own = [r for r in rows if (r["line"], r["along_m"]) == (line, along_m)]
        level, *figures = [_mean(own, score, form) for score, form in VIEWPOINT_SCORES]
        worst = f"{min(r['psnr_db'] for r in own):.1f}"
        lines.append([line, f"{along_m:+.2f}", f"{own[0]['distance_m']:.2f}", level, worst, *figures])
    columns = ("line", "along / m", "nearest camera / m", "PSNR / dB", "worst / dB", "movers / dB", "Abs Rel", "empty")
    return markdown(columns, lines)


def _mean(rows: Sequence[dict], score: str, form: str) -> str:
    found = [row[score] for row in rows if score in row]
    return format(float(np.mean(found)), form) if found else ""


def _cases(documents: Documents) -> str:
    """Each case on how many backends, its worst errors, and whether any failed."""
    rows = documents["stability"]["rows"]
    lines = []
    for case in dict.fromkeys(row["case"] for row in rows):
        own = [row for row in rows if row["case"] == case]
        worst = [max((r[k] for r in own if r.get(k) is not None), default=None) for k in ("error", "gradient")]
        errors = ["-" if w is None else f"{w:.1e}" for w in worst]
        failed = ", ".join(r["backend"] for r in own if r["verdict"] == "fail")
        lines.append([case, own[0]["expected"], str(len(own)), *errors, f"fail: {failed}" if failed else "pass"])
    return markdown(("case", "expected", "rows", "worst error", "worst gradient", "verdict"), lines)


def _left_out(documents: Documents) -> str:
    """Each case, and each decision of it, at equal steps: what the plan saves and what it costs."""
    summary = documents["leave-out"]["summary"]
    lines = []
    for key in (key.removesuffix(".saved_s") for key in summary if key.endswith(".saved_s")):
        case, _, decision = key.partition(".")
        values = [(summary.get(f"{key}.{name}"), form) for name, form in LEFT_OUT_SCORES]
        figures = ["" if value is None else format(value, form) for value, form in values]
        lines.append([case, decision or "everything on", *figures])
    columns = ("case", "against", "saves / s", "claims / s", "saves / MB", "claims / MB", "costs / dB", "movers / dB")
    return markdown(columns, lines)


TABLES: Mapping[str, Mapping[str, Callable[[Documents], str]]] = {
    "paper": {
        **{t.name: _measured(t.name) for t in PROTOCOL.tables},
        "time": lambda documents: _body(time_table(ordinary(documents["paper"]["rows"]))),
        "scenes": _scenes,
        "omissions": _omissions,
    },
    "images": {"paper": lambda documents: _body(other_table("images", "", documents["images"], IMAGE_ROWS))},
    "poses": {"paper": lambda documents: _body(other_table("poses", "", documents["poses"], POSE_ROWS))},
    "viewpoints": {"places": _viewpoints},
    "stability": {"cases": _cases},
    "leave-out": {"plans": _left_out},
}
