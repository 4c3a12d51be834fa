"""Measurements one can repeat: each prints one document of rows and a flat summary."""
