"""MSDI: from the spikes of several views to images, depth and poses at once (Spike4DGS, NeurIPS 2025)."""
