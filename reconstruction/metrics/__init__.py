"""Metrics of images, depths and poses."""
