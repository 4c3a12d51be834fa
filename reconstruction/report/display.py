"""Linear light as the grey of a screen, and the span of a depth map; needs numpy alone."""

import numpy as np
from numpy.typing import NDArray

Pixels = NDArray[np.uint8]
GAMMA = 1 / 2.2  # exponent from linear light to display grey


def grey(image: NDArray[np.float32], white: float) -> Pixels:
    """Return linear intensity [H, W] as 8-bit grey [H, W]: divided by `white`, clipped to 0 to 1, gamma 2.2."""
    return np.round(np.clip(image / max(white, 1e-9), 0, 1) ** GAMMA * 255).astype(np.uint8)


def depth_span_m(depth: NDArray[np.float32]) -> tuple[float, float]:
    """Return the 1st and 99th percentile of the known depths in m [H, W]; 1 and 2 m where nothing is known."""
    known = depth[np.isfinite(depth)]
    if known.size == 0:
        return 1.0, 2.0
    near, far = np.percentile(known, [1, 99])
    return float(near), float(max(far, near * 1.01))
