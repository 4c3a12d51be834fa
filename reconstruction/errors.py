"""Errors of image formation, initialisation, training and rendering."""

from rigs.errors import Spike4dgsError


class ReconstructionError(Spike4dgsError):
    """Root of the errors raised by `reconstruction`."""

    bad_input = True


class BadRunError(ReconstructionError):
    """A run folder, configuration or request that cannot be used."""

    exit_code = 2


class StereoError(ReconstructionError):
    """Too few points survived initialisation; training would not recover."""


class GeometryError(ReconstructionError):
    """Poses that a recording does not tell, or that cannot be trusted; `found` names the views."""
