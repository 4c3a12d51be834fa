"""The recordings that benches share: found in their work folder, simulated where there is none."""

import subprocess
import sys
from pathlib import Path

from acquisition.errors import AcquisitionError
from acquisition.scenes.catalog import DEVELOPMENT, DEVELOPMENT_SEEDS, EVALUATION_SEEDS

TICKS = 400


def recorded(scenes: tuple[str, ...], work: Path, ticks: int = TICKS) -> list[tuple[str, int, Path]]:
    """A recording of each scene in `work`, by the seed that all benches use: scene, seed, folder."""
    seeds = {scene: DEVELOPMENT_SEEDS[1] if scene in DEVELOPMENT else EVALUATION_SEEDS[0] for scene in scenes}
    return [(scene, seed, recording(scene, seed, work, ticks)) for scene, seed in seeds.items()]


def recording(scene: str, seed: int, work: Path, ticks: int = TICKS, rig: str | None = None) -> Path:
    """The recording of a scene and seed in `work`.

    Where there is none `simulate` makes it, in a process of its own, whose threads wait as many pools should. Raises
    AcquisitionError where that fails.
    """
    path = work / f"{scene}-{seed}"
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        options = {"scene": scene, "seed": seed, "ticks": ticks, "out": path} | ({"rig": rig} if rig else {})
        command = [sys.executable, "-m", "server.cli", "simulate"]
        command += [word for k, v in options.items() for word in (f"--{k}", str(v))]
        if subprocess.run(command, stdout=sys.stderr).returncode:
            raise AcquisitionError("found that simulate failed", "a recording", "its reason is above", where=path)
    return path
