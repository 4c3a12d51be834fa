"""What a camera array is: transforms, cameras, the rig, its clock, and the files that describe it."""
