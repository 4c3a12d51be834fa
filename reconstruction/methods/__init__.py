"""What `--model` names: how each method starts and what it is published with; ours, and the baselines one file each."""
