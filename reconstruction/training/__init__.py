"""Fits a model to what was recorded: terms, steps, rates, checkpoints."""
