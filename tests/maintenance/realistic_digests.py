"""Digests the realistic evaluation scenes: meshes, finishes, lamps, and where things are at fixed instants.

Places are rounded to a millimetre, a fraction of a pixel. Pictures are known by their names in packages of a stated
version. Running this module writes the committed digests anew: earlier figures are then incomparable with later ones.
It needs the extra `realistic` for the physics and the meshes, and draws nothing.
"""

import hashlib
import json
from collections.abc import Sequence

import numpy as np

from acquisition.durable import write_json
from acquisition.scenes.catalog import (
    EVALUATION_SEEDS,
    REALISTIC_EVALUATION,
    REALISTIC_LONG_EVALUATION,
    build_scene,
)
from acquisition.scenes.digest import COMMITTED_REALISTIC
from acquisition.scenes.realistic.setting import Setting

INSTANTS_S = (0.0, 0.005, 0.01, 0.02)
LONG_INSTANTS_S = (0.0, 0.03, 0.07, 0.11, 0.13, 0.17, 0.2)


def setting_digest(setting: Setting, instants_s: Sequence[float] = INSTANTS_S) -> str:
    """Return the SHA-256, in hexadecimal digits, of all that decides what a camera sees."""
    found = hashlib.sha256(json.dumps([repr(lamp) for lamp in setting.lamps]).encode())
    for thing in setting.things:
        found.update(f"{thing.body} {thing.finish!r} {thing.moving}".encode())
        found.update(thing.mesh.faces.astype(np.uint32).tobytes())
        for instant_s in instants_s if thing.moving else instants_s[:1]:
            found.update((np.round(thing.vertices(instant_s) * 1e3) + 0.0).astype(np.int64).tobytes())
        found.update((np.round(thing.mesh.uv * 1e4) + 0.0).astype(np.int64).tobytes())
    return found.hexdigest()


def realistic_digests() -> dict[str, str]:
    """Return the digest of each realistic evaluation scene and seed, by `name-seed`; takes half a minute."""
    return {
        f"{name}-{seed}": setting_digest(build_scene(name, seed).setting, instants_s)
        for names, instants_s in ((REALISTIC_EVALUATION, INSTANTS_S), (REALISTIC_LONG_EVALUATION, LONG_INSTANTS_S))
        for name in names
        for seed in EVALUATION_SEEDS
    }


if __name__ == "__main__":
    write_json(COMMITTED_REALISTIC, realistic_digests())
