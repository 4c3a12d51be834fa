"""Makes up a report in its true form: every part that a report may have, of a run that never was."""

import cv2
import numpy as np

from reconstruction.report.curve import curve_png
from reconstruction.report.html import embed, report_html
from reconstruction.report.pictures import encode_png
from reconstruction.report.table import score_table
from reconstruction.run.decisions import Decision

SCORES = {"psnr_db": 32.5, "ssim": 0.95, "abs_rel": 0.012, "delta_1_25": 0.99}
PICTURES = ("truth", "render", "error x5", "expected error x5", "depth, 1.02 to 3.40 m", "true depth")


def report_page() -> str:
    """Return the page."""
    metrics = {
        f"{floor}{name}": value for floor in ("", "nearest_view.", "depth_blend.") for name, value in SCORES.items()
    }
    rows = [{"seconds": s, "psnr_db": 33 - 14 * 2 ** (-s / 6)} for s in (2.0, 4.0, 8.0, 16.0, 32.0)]
    curve = (rows, "psnr_db", {"nearest_view": 17.0, "depth_blend": 28.0}, "cam11, held out; 5 states of one run")
    decision = Decision(
        about="pose estimation",
        choice="left out",
        reason="the rig file says that its cameras are calibrated",
        override="--init natural",
        saves_s=12.5,
        saves_bytes=None,
    )
    document = {
        "title": "Reconstruction of c20261123-182109-d5047699",
        "subtitle": "400 planes of 9 cameras at 20000 Hz; 640 steps, 47993 Gaussians, revision 0f85079",
        "camera": "cam11",
        "rows": [
            [{"source": embed(picture(n)), "caption": f"{name}, plane {n}"} for name in PICTURES] for n in (80, 200)
        ],
        "table": score_table(metrics),
        "note": "Linear intensity, data range 0.412 spikes per tick; means over instants.",
        "curve": embed(curve_png(*curve)),
        "narrow_curve": embed(curve_png(*curve, narrow=True)),
        "along": "",
        "orbit": "",
        "seconds": {"plan": 3.31, "points": 28.73, "train": 14.79},
        "warnings": ["cam02 is out of focus: its edges are twice as wide as its neighbours'"],
        "decisions": [decision],
        "configuration": {
            "model": "auto",
            "views": ["cam00", "cam01", "cam02", "cam10", "cam12", "cam20", "cam21", "cam22"],
        },
    }
    return report_html(document)


def picture(plane: int) -> bytes:
    """A PNG of a grey ramp, as wide as a camera's picture."""
    ramp = np.tile(np.linspace(0, 255, 400, dtype=np.uint8), (250, 1))
    return encode_png(np.asarray(cv2.circle(ramp, (plane, 120), 30, (255,), -1), np.uint8))
