"""The list of methods that `--model` names."""

import subprocess
import sys

CODE = "import sys; from reconstruction.methods.catalogue import METHODS; print(*METHODS, 'torch' in sys.modules)"


def test_listing_needs_no_torch_and_begins_with_ours():
    listed = subprocess.run([sys.executable, "-c", CODE], capture_output=True, text=True, check=True).stdout.split()
    assert listed[:4] == ["static", "linear", "cubic", "bases"]
    baselines = ["d3dgs", "4dgs", "4dgs-small", "spikegs", "dy-spikegs", "spikenerf", "dy-spikenerf", "stg"]
    assert listed[4:] == [*baselines, "False"]
