"""Recording and rig to points with confidence."""
