"""Tells how far a rendering may be from the truth: evidence of the training views, and the error to expect from it."""
