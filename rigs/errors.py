"""Errors that reach a person: one line saying what was found, what was expected, what to do."""


class Spike4dgsError(Exception):
    """Root of every error this project raises on purpose; `exit_code` is what the command line returns."""

    exit_code = 1


class RigError(Spike4dgsError):
    """A rig, camera or pose that cannot be used."""

    exit_code = 2
