"""Goes between what a bent lens records and the pinhole view that the pipeline works in."""
