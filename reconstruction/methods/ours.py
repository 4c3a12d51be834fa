"""Our own models: still Gaussians beside moving ones that live for a while, straight, bent, or on rigid bodies."""

from reconstruction.methods.definition import Method, RateFactors, Training, seeded

# Weights of the held depths from 0.05 to 0.5 gave the same depths on development recordings; more dims still scenes.
# Movers at half their rates are better in a minute, and hardly worse in a quarter of one (172).
TRAINING = Training(enough_steps=4000, holds_depth=0.05, deblurs=True, rates=RateFactors(moving=0.5))
STATIC = Method("static", seeded("seed_cloud"), moves=False, training=TRAINING, ours=True)
LINEAR = Method("linear", seeded("seed_cloud"), watched=True, training=TRAINING, ours=True)
CUBIC = Method("cubic", seeded("seed_cloud", cubic=True), watched=True, training=TRAINING, ours=True)
# More sweeps have fewer points each, and bodies are followed worse in a recording of one piece (173).
BASES = Method("bases", seeded("seed_parts"), watched=True, training=TRAINING, ours=True, sweeps=4)
