"""How good a run is: metrics against truth, the floors it must beat, and the error-against-time curve."""
