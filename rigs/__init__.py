"""A camera array: transforms, cameras, the rig, its clock, and the files that describe it."""
