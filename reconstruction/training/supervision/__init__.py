"""The losses that `--supervision` names, one file each or one for a family; listing them loads no torch."""
