"""Spacetime Gaussians; the motion of the baseline TFI + STG.

Source: Li et al., "Spacetime Gaussian feature splatting for real-time dynamic view synthesis", CVPR 2024. As published:
cubic paths, quaternions linear in time, an opacity window with a centre and a width of its own, points from several
instants (there from structure from motion, here from sweeps).
Ours: still Gaussians beside them (published: all have a window); grey light in place of features and their network; a
cap in place of densification and of sampling along rays; our rates and kernels.
"""

from reconstruction.methods.definition import Method, seeded

STG = Method("stg", seeded("seed_spacetime"), watched=True)
