"""Scores a run: metrics against truth or spike counts, and the floors it must beat."""
