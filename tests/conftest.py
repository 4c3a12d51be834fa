import os
from pathlib import Path

import pytest
from hypothesis import settings

ROOT = Path(__file__).resolve().parents[1]

# Threads that spin at a barrier take the cores from the tests of the other process.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # has no such policy; the matrices here are small

# No test asserts on elapsed time. What a run draws is the same every time; `make fuzz` draws afresh.
settings.register_profile("repeatable", deadline=None, derandomize=True)
settings.register_profile("fresh", deadline=None)
settings.load_profile("repeatable")


@pytest.fixture(scope="session")
def spikedata() -> Path:
    """Recordings that are not part of the repository, from $SPIKE4DGS_SHARED or beside the checkout."""
    folder = Path(os.environ.get("SPIKE4DGS_SHARED", ROOT.parent / "shared")) / "spikedata"
    if not folder.is_dir():
        pytest.skip(f"no recordings at {folder}; set SPIKE4DGS_SHARED to the folder that holds spikedata")
    return folder


@pytest.fixture(autouse=True, scope="session")
def own_locks(tmp_path_factory):
    """Tests lock rigs among themselves, not against whoever else works on this machine."""
    before = os.environ.get("SPIKE4DGS_LOCKS")
    os.environ["SPIKE4DGS_LOCKS"] = str(tmp_path_factory.mktemp("locks"))
    yield
    if before is None:
        del os.environ["SPIKE4DGS_LOCKS"]
    else:
        os.environ["SPIKE4DGS_LOCKS"] = before
