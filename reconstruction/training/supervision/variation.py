"""Names SPSS, the loss of Spike4DGS on recorded spikes, which is not built yet."""

from reconstruction.training.term import Supervision

VARIATION = Supervision(
    "variation",
    lambda image, sampling: None,
    refused="the loss on recorded spikes is not built yet",
    instead="use image-variation, which compares images",
)
