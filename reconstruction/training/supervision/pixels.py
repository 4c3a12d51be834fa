"""Compares renders with images alone."""

from reconstruction.training.term import Supervision

PIXELS = Supervision("pixels", lambda image, sampling: None)
