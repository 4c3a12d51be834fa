"""Errors of capture, recordings and spike streams."""

from rigs.errors import Spike4dgsError


class AcquisitionError(Spike4dgsError):
    """Root of the errors raised by `acquisition`."""


class BadRecordingError(AcquisitionError):
    """A stream, file or argument that does not describe a usable recording."""

    exit_code = 2
    bad_input = True


class DeviceError(AcquisitionError):
    """A camera that did not do what it was told."""


class StoppedError(DeviceError):
    """A recording that was stopped before anything of it was kept."""


class DiskError(AcquisitionError):
    """A disk that refused what a recording needs; nothing was left under its final name."""

    exit_code = 2


class RigBusyError(DeviceError):
    """A rig that somebody else records with."""

    exit_code = 2


class IncompleteError(DeviceError):
    """A recording that has its name but not all that was asked for."""
