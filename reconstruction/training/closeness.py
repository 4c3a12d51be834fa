"""Measures how close renders are to their images: a figure to watch while a training runs, and for nothing else."""

import math

MEMORY = 50  # images in the mean; single ones differ far more than a training gains between them


class Closeness:
    """A running mean of the squared error of the images compared, with `white` in spikes per tick as the data range.

    A resumed training begins a new mean: nothing that is trained depends on it.
    """

    def __init__(self, white: float) -> None:
        self._white = white
        self._seen = 0
        self._mean_square = 0.0

    def see(self, square: float) -> None:
        """Take in the mean squared error of one render, (spikes per tick)^2."""
        self._seen += 1
        self._mean_square += (square - self._mean_square) / min(self._seen, MEMORY)

    @property
    def psnr_db(self) -> float | None:
        """PSNR of the mean; None before the first image and where all were equal."""
        if not self._seen or self._mean_square <= 0 or not math.isfinite(self._mean_square):
            return None
        return 10 * math.log10(self._white**2 / self._mean_square)

    def __str__(self) -> str:
        """Return `, training PSNR 21.30 dB` for a line of progress; empty where there is no figure."""
        return "" if self.psnr_db is None else f", training PSNR {self.psnr_db:.2f} dB"
