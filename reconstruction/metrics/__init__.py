"""Image and depth metrics, and the floors a reconstruction must beat."""
