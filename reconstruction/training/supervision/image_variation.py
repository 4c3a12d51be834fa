"""Compares how renders change over time with how the images do: the statistics of SPSS, taken of images.

SPSS itself compares renders with the recorded spikes; `variation` is its name here.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from reconstruction.training.term import Supervision

if TYPE_CHECKING:
    from reconstruction.methods.definition import SpikeSampling
    from reconstruction.training.image_term import ImageTerm
    from reconstruction.training.variation_term import ImageVariationTerm


def image_variation_term(image: ImageTerm, sampling: SpikeSampling) -> ImageVariationTerm:
    """Return the term; it looks at images alone, so `sampling` does not matter."""
    from reconstruction.training.variation_term import ImageVariationTerm

    return ImageVariationTerm(image)


IMAGE_VARIATION = Supervision("image-variation", image_variation_term)
