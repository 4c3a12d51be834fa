"""Spacetime Gaussians; the motion of the baseline TFI + STG.

Source: Li et al., "Spacetime Gaussian feature splatting for real-time dynamic view synthesis", CVPR 2024. As published:
cubic paths, quaternions linear in time, an opacity window with a centre and a width of its own, points from several
instants (there from structure from motion, here from sweeps).
Ours: still Gaussians beside them (published: all have a window); grey light in place of features and their network; a
cap in place of densification and of sampling along rays; our rates and kernels.
"""

from reconstruction.methods.definition import Method, RateFactors, Training, seeded

SEARCHED = RateFactors(moving=0.5, motion=0.5)  # as it was (171), with half the rates of movers and of motion (172)
STG = Method("stg", seeded("seed_spacetime"), watched=True, training=Training(rates=SEARCHED))
