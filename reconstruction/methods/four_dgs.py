"""4DGS: canonical Gaussians deformed by a HexPlane field; the model of Spike4DGS and of its baseline TFI + 4DGS.

Source: Wu et al., "4D Gaussian splatting for real-time dynamic scene rendering", CVPR 2024. As published, in sizes,
weights and what deforms for several views: two levels of six planes, one small network, offsets of position, rotation,
size, opacity and light.
Ours: movers from the sweep at the middle of the clip; still Gaussians beside the field (published: all are deformed);
grey light; a cap in place of densification; our rates and kernels.
`4dgs-small` makes several times as many steps a second: half the cells (32 and 64) and width (64), 25 times for 150,
opacity and light not deformed.
"""

from reconstruction.methods.definition import Method, RateFactors, Training, seeded

# Of `4dgs`: the best of twelve trials (171), with half the rates of movers (172).
SEARCHED = RateFactors(still=0.879, moving=0.458, motion=3.272)
FOUR_DGS = Method("4dgs", seeded("seed_field"), canonical=0.5, watched=True, training=Training(rates=SEARCHED))
SMALL_FOUR_DGS = Method("4dgs-small", seeded("seed_field", kind="4dgs-small"), canonical=0.5, watched=True)
