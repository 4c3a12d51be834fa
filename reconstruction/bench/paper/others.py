"""Pairs figures of the image and pose benches with the paper's."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from reconstruction.bench.paper.protocol import NO_DUST3R

OTHERS = ("images", "poses")
NO_SEPARATE = "no weights are shipped; `python -m reconstruction.networks.train msdi --separate` makes some"


@dataclass(frozen=True)
class OtherRow:
    """A line of a table: by metric, `keys` hold the name in the summary and the factor to the table's unit."""

    label: str
    paper: str | None = None
    keys: Mapping[str, tuple[str, float]] = field(default_factory=dict)
    omitted: str = ""


def open_others(out: Path) -> dict[str, dict | None]:
    """Return the documents of the other benches in a folder; None for one that is not there."""
    files = {name: out / f"{name}.json" for name in OTHERS}
    return {name: json.loads(file.read_text()) if file.exists() else None for name, file in files.items()}


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
