import os
from pathlib import Path

import pytest
from hypothesis import settings

ROOT = Path(__file__).resolve().parents[1]

settings.register_profile("untimed", deadline=None)  # no test asserts on elapsed time
settings.load_profile("untimed")


@pytest.fixture(scope="session")
def spikedata() -> Path:
    """Recordings that are not part of the repository, from $SPIKE4DGS_SHARED or beside the checkout."""
    folder = Path(os.environ.get("SPIKE4DGS_SHARED", ROOT.parent / "shared")) / "spikedata"
    if not folder.is_dir():
        pytest.skip(f"no recordings at {folder}; set SPIKE4DGS_SHARED to the folder that holds spikedata")
    return folder
