"""The report's curve: text that can be read, and nothing cut off, on a screen and on a telephone."""

import cv2
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.text import Text

from reconstruction.report.curve import NARROW_IN, WIDE_IN, along_png, curve_figure, curve_png

SHOWN_PX = {True: 368, False: 770}  # widths in the report: on a telephone of 400 px, and on a screen
LEAST_PX = 11.5
CAPTION = "cam11, held out; 24 states of one run, scored after it"
RUNS = {
    "minutes": [{"seconds": s, "psnr_db": 30 - 12 * 2 ** (-s / 20)} for s in (8, 12, 16, 24, 32, 45, 60, 90)],
    "hours": [{"seconds": s, "psnr_db": -101.25 + s / 1e5} for s in (700.5, 90_000.0, 250_000.0)],
    "one": [{"seconds": 31.5, "psnr_db": 21.0}],
}


@pytest.mark.parametrize("narrow", [True, False])
@pytest.mark.parametrize("run", RUNS)
def test_its_text_is_large_enough_and_whole(run: str, narrow: bool) -> None:
    floors = {"nearest_view": 17.0, "depth_blend": 28.0}
    figure = curve_figure(RUNS[run], "psnr_db", floors, CAPTION, narrow=narrow)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    width_in, height_in = NARROW_IN if narrow else WIDE_IN
    seen = [text for text in figure.findobj(Text) if text.get_visible() and text.get_text().strip()]
    assert {"wall seconds since the start", "reconstruction", "nearest view"} <= {
        text.get_text().split(",")[0] for text in seen
    }
    drawn = [text for text in seen if text.get_window_extent().width]
    for text in drawn:
        css_px = text.get_fontsize() / 72 * SHOWN_PX[narrow] / width_in
        assert css_px >= LEAST_PX, text
    labels = [text for text in drawn if not is_tick_outside(text, figure)]
    for text in labels:
        box = text.get_window_extent()
        assert min(box.x0, box.y0) >= 0, text
        assert max(box.x1 / width_in, box.y1 / height_in) <= figure.dpi, text


def is_tick_outside(text: Text, figure) -> bool:
    """Tell whether a text is the label of a tick beyond the axis, which is not drawn."""
    axes = figure.axes[0]
    for axis, limits in ((axes.xaxis, axes.get_xlim()), (axes.yaxis, axes.get_ylim())):
        for tick in (*axis.get_major_ticks(), *axis.get_minor_ticks()):
            if text in (tick.label1, tick.label2):
                return not min(limits) <= tick.get_loc() <= max(limits)
    return False


@pytest.mark.parametrize("narrow", [True, False])
def test_it_is_a_picture_of_its_size(narrow: bool) -> None:
    data = curve_png(RUNS["minutes"], "psnr_db", {}, CAPTION, narrow=narrow)
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE)
    assert image is not None
    assert image.shape[1] >= SHOWN_PX[narrow] * (2 if narrow else 1)


def test_a_long_recording_has_a_curve_along_it():
    spans = [{"first_tick": 400 * i, "last_tick": 400 * i + 399, "psnr_db": 30.0 + i} for i in range(3)]
    spans[1]["dynamic_psnr_db"] = 25.0
    assert along_png(spans).startswith(b"\x89PNG")
    assert along_png([{"first_tick": 0, "last_tick": 9, "seconds": 1.0}]) == b""
    assert along_png([]) == b""
