"""Rigs in the formats of other tools: nerfstudio's transforms.json and COLMAP model folders."""
