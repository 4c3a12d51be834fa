"""Finds cameras from recordings: their places, their turns and their lenses."""
