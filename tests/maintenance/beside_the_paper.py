"""Puts figures of the image and pose benches beside the paper's."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from reconstruction.bench.paper.protocol import NO_DUST3R
from reconstruction.bench.paper.published import Figures, quality
from reconstruction.bench.paper.tables import HOW, PAPER, figures_of, markdown

NO_SEPARATE = "no weights are shipped; `python -m reconstruction.networks.train msdi --separate` makes some"


@dataclass(frozen=True)
class OtherRow:
    """A line of a table: by metric, `keys` hold the name in the summary and the factor to the table's unit."""

    label: str
    paper: str | None = None
    keys: Mapping[str, tuple[str, float]] = field(default_factory=dict)
    omitted: str = ""


def _published(rotation_deg: float, translation_percent: float, seconds: float | None = None) -> Figures:
    found = {"rotation_deg": rotation_deg, "translation_percent": translation_percent}
    return found if seconds is None else found | {"seconds": seconds}


PUBLISHED_IMAGES: Mapping[str, Figures] = {
    "TFI": quality(24.51, 0.850),
    "TFP": quality(25.37, 0.852),
    "TVS": quality(22.43, 0.821),
    "Spk2ImgNet": quality(30.76, 0.904),
    "MSDI (joint)": quality(34.90, 0.961),
    "MSDI (separate)": quality(30.12, 0.911),
}
PUBLISHED_POSES: Mapping[str, Figures] = {
    "TFI + COLMAP": _published(2.72, 9.8, 30.3),
    "TFI + DUSt3R": _published(1.27, 3.5, 9.6),
    "MSDI images + COLMAP": _published(2.62, 9.6),
    "MSDI images + DUSt3R": _published(1.19, 3.2),
    "MSDI": _published(0.94, 2.1, 9.1),
    "MSDI trained separately": _published(0.98, 2.3),
}


def _image(label: str, method: str, paper: str | None = None) -> OtherRow:
    keys = {metric: (f"{method}.{metric}", 1.0) for metric in ("psnr_db", "ssim")}
    return OtherRow(label, paper, keys | {"seconds": (f"{method}.ms_per_image", 1e-3)})


def _pose(label: str, method: str, paper: str | None = None) -> OtherRow:
    metrics = ("rotation_deg", "translation_percent", "seconds")
    return OtherRow(label, paper, {metric: (f"{method}.{metric}", 1.0) for metric in metrics})


IMAGE_ROWS = (
    _image("TFI", "tfi", "TFI"),
    _image("TFP", "tfp", "TFP"),
    _image("TVS", "tvs", "TVS"),
    _image("TFSTP", "tfstp"),
    _image("slope", "slope"),
    _image("adaptive", "adaptive"),
    _image("interpolated (ours)", "interpolated"),
    _image("small Spk2ImgNet", "spk2imgnet", "Spk2ImgNet"),
    _image("blind spot", "blindspot"),
    _image("small MSDI", "msdi", "MSDI (joint)"),
    OtherRow("MSDI, trained separately", "MSDI (separate)", omitted=NO_SEPARATE),
)
POSE_ROWS = (
    _pose("the rig as drawn", "nominal"),
    _pose("TFI + COLMAP", "tfi+colmap", "TFI + COLMAP"),
    _pose("small MSDI images + COLMAP", "msdi-image+colmap", "MSDI images + COLMAP"),
    _pose("long-window images + COLMAP", "long+colmap"),
    _pose("small MSDI alone", "msdi", "MSDI"),
    _pose("small MSDI, adjusted", "msdi+ba"),
    _pose("natural calibration (ours)", "natural"),
    _pose("a ChArUco board", "board"),
    OtherRow("TFI + DUSt3R", "TFI + DUSt3R", omitted=NO_DUST3R),
    OtherRow("MSDI images + DUSt3R", "MSDI images + DUSt3R", omitted=NO_DUST3R),
    OtherRow("MSDI trained separately", "MSDI trained separately", omitted=NO_SEPARATE),
)
BESIDE = {"images": (IMAGE_ROWS, PUBLISHED_IMAGES), "poses": (POSE_ROWS, PUBLISHED_POSES)}


def paper_table(name: str, document: dict) -> str:
    """Return the table of a document's figures beside the paper's, which are of other scenes."""
    rows, published = BESIDE[name]
    summary, lines, absent = document["summary"], [], []
    for row in rows:
        ours = {metric: summary[key] * scale for metric, (key, scale) in row.keys.items() if key in summary}
        if ours:
            lines.append([row.label, _fine(ours), figures_of(published.get(row.paper or "", {}))])
        else:
            absent.append(f"{row.label} ({row.omitted or 'not in the document'})")
    table = markdown(("row", "ours", PAPER), lines)
    return f"{table}\n\nWithout a measurement: {'; '.join(absent)}."


def _fine(ours: Mapping[str, float]) -> str:
    """Return our figures with the digits they need: errors of poses and seconds are small."""
    digits = {"rotation_deg": "{:.3f} deg", "translation_percent": "{:.3f} %", "seconds": "{:.3g} s"}
    return ", ".join((HOW | digits)[metric].format(value) for metric, value in ours.items())
