"""The methods that `--model` names, in one file each: how a model starts, and what its source publishes with it."""
