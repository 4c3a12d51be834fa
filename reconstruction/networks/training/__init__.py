"""The training of the networks: random scenes, losses, one resumable loop, scores and curves."""
