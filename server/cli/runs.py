"""Opens the runs that commands are given."""

from pathlib import Path

from reconstruction.errors import BadRunError
from reconstruction.run.configuration import STAGES
from reconstruction.run.folder import RunFolder


def trained_run(folder: Path) -> RunFolder:
    """Open a run that has a scene; raises BadRunError for one that ended before its training."""
    run = RunFolder.open(folder)
    if not run.checkpoint.exists():
        lacking = next((stage for stage in STAGES if not run.has(stage)), "train")
        raise BadRunError(
            f"found no scene: the run ended in its {lacking} stage",
            do="give its `spike4dgs reconstruct` again, which says why",
            where=folder,
        )
    return run
