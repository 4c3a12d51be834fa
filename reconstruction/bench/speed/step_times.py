"""Times single steps of training, as a script for the Python of any revision: run it by path, and not as a module.

It imports what that Python has installed, and of the bench only what revisions have in common. Each line of standard
input is a JSON object with the arguments of `steps_taken`; its answer is a line with the seconds of each step and
its parts. The first line that is printed is the revision.
"""

import functools
import json
import sys
import time

import torch

from acquisition.revision import code_revision
from reconstruction.bench.rasterizer import Step, random_cloud
from rigs.toml import catalog_rig

WHOLE = "step"  # the name of a whole step among its parts
WARM_UP = 2  # steps that are not timed


@functools.lru_cache(maxsize=1)
def step_of(gaussians: int, width: int, height: int) -> Step:
    """Return the step of a random cloud before the lab rig's centre camera; the last one is kept."""
    camera = catalog_rig("lab3x3").camera("cam11").scaled(width, height)
    return Step(random_cloud(gaussians, camera), camera)


def steps_taken(gaussians: int, width: int, height: int, threads: int, repeats: int) -> list[dict[str, float]]:
    """Return the seconds of each of `repeats` whole steps (WHOLE), and of the parts of one more, on so many threads."""
    torch.set_num_threads(threads)
    step, seconds = step_of(gaussians, width, height), []
    for _ in range(WARM_UP + repeats):
        began = time.perf_counter()
        step.whole()
        seconds.append({WHOLE: time.perf_counter() - began} | step.parts())
    return seconds[WARM_UP:]


def main() -> None:
    """Answer every line of standard input."""
    _say(code_revision())
    for line in sys.stdin:
        _say(steps_taken(**json.loads(line)))


def _say(answer: str | list[dict[str, float]]) -> None:
    sys.stdout.write(json.dumps(answer) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
