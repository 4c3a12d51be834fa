"""The realistic scenes, one file each."""
