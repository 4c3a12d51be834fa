"""4DGS: canonical Gaussians deformed by a HexPlane field; the model of Spike4DGS and of its baseline TFI + 4DGS.

Source: Wu et al., "4D Gaussian splatting for real-time dynamic scene rendering", CVPR 2024. As published: two levels of
six planes, one small network, offsets of position, rotation and size.
Ours: a smaller field than published for several views (cells 32 and 64 for 64 and 128, 25 times for 150, width 64 for
128), opacity and colour not deformed, smoothness in time 0.01 for 0.001 (`gaussians.hexplane`); movers from the sweep
at the middle of the clip; still Gaussians beside the field (published: all are deformed); a cap in place of
densification; our rates and kernels.
"""

from reconstruction.methods.definition import Method, seeded

FOUR_DGS = Method("4dgs", seeded("seed_field"), canonical=0.5, watched=True)
