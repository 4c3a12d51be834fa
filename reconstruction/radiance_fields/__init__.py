"""Radiance fields on sparse grids: the frustum they fill, the march of a ray through them, and how they deform."""
