"""The drivers on a real Linux USB stack: boots a kernel, and runs the camera contract inside."""

import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
GUEST = """
export PYTHONDONTWRITEBYTECODE=1 HOME=/dev/shm TMPDIR=/dev/shm
cd {root}
{python} -m pytest -p no:cacheprovider -m 'not slow' -q tests/contract -k "IpBench or is_connected"
echo "USBVM ENDED $?"
"""


@pytest.fixture
def boot() -> Path:
    """The program that boots a kernel and runs a script inside: $SPIKE4DGS_USBVM, or a ready User-Mode Linux."""
    folder = Path(os.environ.get("SPIKE4DGS_SHARED", ROOT.parent / "shared")) / "usbvm"
    program = Path(os.environ.get("SPIKE4DGS_USBVM", folder / "uml.sh"))
    if not program.is_file():
        pytest.skip(f"no kernel at {program}; run `make usbvm`, which boots one in QEMU")
    return program.resolve()


@pytest.mark.usbvm
@pytest.mark.slow
def test_the_drivers_hold_their_contract_on_a_real_usb_stack(boot, tmp_path, capsys):
    guest = tmp_path / "guest.sh"
    guest.write_text(GUEST.format(root=shlex.quote(str(ROOT)), python=shlex.quote(sys.executable)))
    environment = {**os.environ, "TMO": "900"}
    run = subprocess.run([boot, guest], capture_output=True, text=True, errors="replace", env=environment)
    with capsys.disabled():
        told = [line for line in run.stdout.splitlines() if line.startswith("UsbIpBench: ")]
        sys.stdout.write("\n" + "\n".join(told) + "\n")
    assert "USBVM ENDED 0" in run.stdout, run.stdout[-8000:]
