"""A recording to Gaussians to pictures."""
