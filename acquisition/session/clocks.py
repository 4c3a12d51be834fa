"""What the sync pulses of a run told of each camera's clock, for the manifest."""

import json

import numpy as np

from acquisition.session.capture import Capture
from acquisition.session.timing import TimingError, estimate_clock


def tell_clock(capture: Capture, period_s: float, tick_rate_hz: float) -> None:
    """Estimate the clock of one camera that has been recorded; where pulses cannot tell, its skew stays unknown."""
    if not capture.stamps:
        return
    counted, stamps_s = zip(*capture.stamps, strict=True)
    try:
        duration_s = capture.writer.planes / tick_rate_hz
        estimate = estimate_clock(np.array(counted), np.array(stamps_s), period_s, duration_s)
    except TimingError:
        return
    estimate = estimate.with_missed_until(capture.stamped_until_s, float(stamps_s[-1]), period_s)
    capture.writer.clock = json.loads(json.dumps(estimate.to_json()))
