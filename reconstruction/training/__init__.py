"""Configuration, the plan, the trainer, checkpoints."""
