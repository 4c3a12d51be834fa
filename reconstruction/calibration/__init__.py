"""What the cameras are, found from recordings: where they stand and how they see."""
