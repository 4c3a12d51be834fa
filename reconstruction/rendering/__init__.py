"""Gaussians to images: the public renderer, its torch reference, the native kernels."""
