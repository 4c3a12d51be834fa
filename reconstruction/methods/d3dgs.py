"""Dynamic 3D Gaussians, timestep by timestep; the motion of the baseline TFI + D3DGS.

Source: Luiten et al., "Dynamic 3D Gaussians: tracking by persistent dynamic view synthesis", 3DV 2024. As published:
the first timestep learns everything and later ones only positions and rotations, from the last plus their change, under
local rigidity, local rotation and isometry; what enters later has no Gaussians of its own.
Ours: 13 timesteps and as many steps as the budget allows, some 3,000 in a minute (published: one timestep an image,
10,000 steps for the first and 2,000 for each later one); Gaussians of the still scene beside them, learnt all the time
(published: one cloud, whose background is held by a mask); several instants between two timesteps, linearly
interpolated (published: one image a timestep); movers from the sweep at the first instant; a cap in place of
densification; our rates and kernels.
"""

from reconstruction.methods.definition import Method, RateFactors, Training, seeded

# The best of twelve trials (171), with half the rates of movers (172).
SEARCHED = RateFactors(still=2.253, moving=0.783, motion=2.166)
TRAINING = Training(ends_early=False, rates=SEARCHED)
D3DGS = Method("d3dgs", seeded("seed_timesteps"), canonical=0.0, training=TRAINING)
