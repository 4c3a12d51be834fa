"""The losses that `--supervision` names, ours in one file; listing them loads no torch."""
