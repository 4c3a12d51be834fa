"""Scenes that a path tracer draws and a physics engine moves: an optional extra, `spike4dgs[realistic]`."""
