"""The networks: how they are built, trained, stored and run."""
