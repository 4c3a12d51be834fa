"""The networks: their layers, their weights, their training and their use."""
