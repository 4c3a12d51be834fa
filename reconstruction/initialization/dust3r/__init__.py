"""Poses and points from pairs of images by a network that the user supplies the weights of (DUSt3R)."""
