"""Describes one run: what was asked for, what was decided, what it costs, and the folder it lives in."""
