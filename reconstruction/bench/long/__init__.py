"""Recordings in spans, their seams, and parts of them alone."""
