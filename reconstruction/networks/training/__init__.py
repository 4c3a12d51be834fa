"""How the networks are trained: random scenes, losses, one resumable loop, scores and curves."""
