"""Ours beside its rivals, each length as a run of its own."""
