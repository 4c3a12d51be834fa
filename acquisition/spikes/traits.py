"""Traits of a sensor beyond the plain model, each off by default, and what they draw for its pixels.

Fixed patterns are a sum of components that pixels, rows and columns have of their own: El Gamal et al., "Modeling and
estimation of FPN components in CMOS image sensors", Proc. SPIE 3301, 1998; EMVA Standard 1288 measures them so.
"""

from dataclasses import dataclass, field, fields, replace

import numpy as np
from numpy.typing import NDArray

from acquisition.errors import BadRecordingError

DOUBLING_K = 8.0  # kelvin in which dark current doubles; 5 to 8: Theuwissen, harvestimaging.com, September 2009
FAILING_SPAN = 1000  # ticks that `failing` is a share of the pixels for
STUCK_SHARE = 0.5  # of the pixels that fail; the others turn hot
HOT_LEVELS = (0.2, 0.6)  # spikes per tick of a hot pixel in the dark


def _trait(most: float, about: str) -> float:
    return field(default=0.0, metadata={"most": most, "about": about})


@dataclass(frozen=True)
class Traits:
    """Numbers of the traits; raises BadRecordingError for a number outside its range."""

    pixel_spread: float = _trait(0.3, "Spread the gain of pixels by this share more (standard deviation).")
    line_spread: float = _trait(0.1, "Spread a gain that each row, and each column, has to itself, by this share.")
    warmer_k: float = _trait(80.0, f"Warm the sensor by so many kelvin; dark current doubles every {DOUBLING_K:g}.")
    row_jitter: float = _trait(0.1, "Let the instant at which a row is read wander by so many ticks.")
    blooming: float = _trait(1.0, "Pass this share of the light that saturates a pixel on to its neighbours.")
    failing: float = _trait(0.2, f"Let this share of the pixels turn hot or stuck in {FAILING_SPAN} ticks.")

    def __post_init__(self) -> None:
        for f in fields(self):
            if not 0 <= getattr(self, f.name) <= f.metadata["most"]:
                raise BadRecordingError(f"found {f.name} {getattr(self, f.name)}", f"0 to {f.metadata['most']:g}")

    def over(self, others: "Traits") -> "Traits":
        """Return these traits, those that are off as `others` have them."""
        chosen = {f.name: getattr(self, f.name) for f in fields(self) if getattr(self, f.name)}
        return replace(others, **chosen)


PLAIN = Traits()
# Half the gain spread of an uncorrected sensor in SCSim (see `sensor`), a sixth of it by lines; 30 K above the air, as
# in a closed housing; rows read some of 250 row times early or late. Blooming and failures are ours, to stress.
HARSH = Traits(pixel_spread=0.03, line_spread=0.005, warmer_k=30.0, row_jitter=0.01, blooming=0.5, failing=5e-4)


@dataclass(frozen=True, eq=False)
class Failures:
    """The pixels [k] that fail, in the order of their ticks [k], and the dark current [k] they have from then on."""

    pixels: NDArray[np.int64]
    ticks: NDArray[np.int64]
    dark: NDArray[np.float64]

    def between(self, first: int, last: int) -> list[int]:
        """Return the different ticks in [first, last) at which something fails."""
        return np.unique(self.ticks[(self.ticks >= first) & (self.ticks < last)]).tolist()

    def at(self, tick: int) -> slice:
        """Return the failures of one tick."""
        return slice(*np.searchsorted(self.ticks, (tick, tick + 1)))


def spread_gain(rng: np.random.Generator, traits: Traits, shape: tuple[int, int]) -> NDArray[np.float64]:
    """Draw the factors [H * W] that pixels, rows and columns add to the gain; never negative."""
    height, width = shape
    lines = rng.standard_normal((height, 1)) + rng.standard_normal((1, width))
    spread = traits.pixel_spread * rng.standard_normal(shape) + traits.line_spread * lines
    return np.maximum(0, 1 + spread).ravel()


def draw_failures(rng: np.random.Generator, traits: Traits, pixels: int) -> Failures:
    """Draw when pixels fail, each at random and by itself; a stuck one never fires again, a hot one leaks."""
    ticks = np.floor(rng.exponential(FAILING_SPAN, pixels) / max(traits.failing, 1e-300))
    levels = rng.uniform(*HOT_LEVELS, pixels)
    dark = np.where(rng.random(pixels) < STUCK_SHARE, 0.0, levels)
    failing = np.flatnonzero(ticks < 2**62)
    failing = failing[np.argsort(ticks[failing], kind="stable")]
    return Failures(failing, ticks[failing].astype(np.int64), dark[failing])
