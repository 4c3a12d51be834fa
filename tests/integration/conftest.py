import sys
from typing import NamedTuple

import pytest
from maintenance.operator_page import capture, chromium, done, open_page, seen, service  # noqa: F401  fixtures

from acquisition.devices.open import Simulation
from acquisition.session.record import simulate
from rigs.toml import catalog_rig
from server.cli.main import main


class Ended(NamedTuple):
    """The end of a command: its exit status, standard output, and lines of standard error."""

    status: int
    out: str
    lines: list[str]

    def refused(self, *words):
        """Return whether it refused its input with `words` in the last line, and without a traceback."""
        said = "\n".join(self.lines)
        assert self.status == 2, said
        assert "Traceback" not in said
        for word in words:
            assert word in self.lines[-1]
        return True


@pytest.fixture
def spike4dgs(monkeypatch, capsys):
    """Runs the command line in this process, which has loaded its modules already; gives an `Ended`."""

    def run(*args):
        monkeypatch.setattr(sys, "argv", ["spike4dgs", *map(str, args)])
        with pytest.raises(SystemExit) as caught:
            main()
        out, err = capsys.readouterr()
        return Ended(caught.value.code or 0, out, err.strip().splitlines())

    return run


@pytest.fixture(scope="session")
def small_recording(tmp_path_factory):
    """Nine cameras of 160x102 before things that move, 128 planes."""
    path = tmp_path_factory.mktemp("recordings") / "rec"
    simulate(Simulation("fan_and_ball", seed=3), catalog_rig("ci3x3").scaled(160, 102), 128, path)
    return path


@pytest.fixture(scope="session")
def long_recording(tmp_path_factory):
    """Nine cameras before things that move, 300 planes: three spans of 100."""
    path = tmp_path_factory.mktemp("recordings") / "rec"
    simulate(Simulation("fan_and_ball", seed=3), catalog_rig("ci3x3"), 300, path)
    return path
