import sys

import pytest

from server.cli.main import main


@pytest.fixture
def spike4dgs(monkeypatch, capsys):
    """Runs the command line in this process; gives its exit status, standard output, and lines of standard error."""

    def run(*args):
        monkeypatch.setattr(sys, "argv", ["spike4dgs", *map(str, args)])
        with pytest.raises(SystemExit) as caught:
            main()
        out, err = capsys.readouterr()
        return caught.value.code, out, err.strip().splitlines()

    return run
