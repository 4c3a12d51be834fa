"""Spike planes: layout, packing, memory-mapped streams and the integrate-and-fire sensor."""
