"""Spikes to images, one file a method."""
