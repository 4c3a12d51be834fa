"""Names the code that made a result."""

import subprocess
from importlib.metadata import version
from pathlib import Path


def code_revision() -> str:
    """Return the commit the code stands at, or the installed version outside a checkout."""
    here = Path(__file__).resolve().parent
    command = ["git", "-C", str(here), "describe", "--always", "--dirty"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return version("spike4dgs")
