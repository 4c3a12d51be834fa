"""The recordings that benches share: kept in their work folder, and simulated if they are not there yet."""

import subprocess
import sys
from pathlib import Path

from acquisition.errors import AcquisitionError
from acquisition.scenes.catalog import DEVELOPMENT, DEVELOPMENT_SEEDS, EVALUATION_SEEDS

TICKS = 400


def recorded(scenes: tuple[str, ...], work: Path, ticks: int = TICKS) -> list[tuple[str, int, Path]]:
    """Return scene, seed and recording of each scene, by the seed that all benches use."""
    seeds = {scene: DEVELOPMENT_SEEDS[1] if scene in DEVELOPMENT else EVALUATION_SEEDS[0] for scene in scenes}
    return [(scene, seed, recording(scene, seed, work, ticks)) for scene, seed in seeds.items()]


def recording(scene: str, seed: int, work: Path, ticks: int = TICKS, rig: str | None = None) -> Path:
    """Return the recording of a scene and seed in `work`, simulated if it is not there yet.

    `simulate` runs in a process of its own, where idle threads sleep: it has a pool for each of nine cameras. Raises
    AcquisitionError if it fails.
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
