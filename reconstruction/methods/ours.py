"""Our own models: still Gaussians beside moving ones that live for a while, straight, bent, or on rigid bodies."""

from __future__ import annotations

from typing import TYPE_CHECKING

from reconstruction.methods.definition import Method, Seeds, Training

if TYPE_CHECKING:
    from reconstruction.gaussians.dynamic import DynamicCloud


def _linear(seeds: Seeds) -> DynamicCloud:
    from reconstruction.initialization.seeding import seed_cloud

    return seed_cloud(seeds.still, seeds.moving, seeds.clip, seeds.instants)


def _cubic(seeds: Seeds) -> DynamicCloud:
    from reconstruction.initialization.seeding import seed_cloud

    return seed_cloud(seeds.still, seeds.moving, seeds.clip, seeds.instants, cubic=True)


def _bases(seeds: Seeds) -> DynamicCloud:
    from reconstruction.initialization.seeding import seed_rigid

    return seed_rigid(seeds.still, seeds.moving, seeds.clip, seeds.instants, seeds.bodies())


# Weights of the held depths from 0.05 to 0.5 gave the same depths on development recordings; more dims still scenes.
TRAINING = Training(holds_depth=0.05, deblurs=True)
STATIC = Method("static", _linear, moves=False, training=TRAINING, ours=True)
LINEAR = Method("linear", _linear, watched=True, training=TRAINING, ours=True)
CUBIC = Method("cubic", _cubic, watched=True, training=TRAINING, ours=True)
BASES = Method("bases", _bases, watched=True, training=TRAINING, ours=True)
