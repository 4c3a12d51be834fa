"""The demo, where it cannot begin or its service dies."""

import signal
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner
from maintenance.ports import free_port

from server.cli import demo
from server.cli.main import cli


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--steps", "100", "--budget-s", "30"), "found both --budget-s and --steps, expected at most one"),
        (("--budget-s", "0"), "--budget-s: found 0.0; Input should be greater than 0"),
        (("--budget-s", "nan"), "--budget-s: found nan; "),
        (("--ticks", "20000000"), "--ticks: found 20000000; Input should be less than or equal to 10000000"),
        (("--seed", "3000000000"), "--seed: found 3000000000; "),
    ],
    ids=lambda part: " ".join(part) if isinstance(part, tuple) else "",
)
def test_options_that_the_service_would_refuse_are_refused_at_once(
    options: tuple[str, ...], said: str, tmp_path: Path
) -> None:
    ended = CliRunner().invoke(cli, ["demo", "--out", str(tmp_path / "demo"), *options])
    assert (ended.exit_code, said in ended.output) == (2, True), ended.output
    assert not (tmp_path / "demo").exists()


def test_a_service_that_dies_is_told_in_a_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    said = f"print('http://127.0.0.1:{free_port()}')"
    monkeypatch.setattr(demo, "leashed", lambda command, name: [sys.executable, "-c", said])
    monkeypatch.setattr(signal, "signal", lambda *_: None)
    ended = CliRunner().invoke(cli, ["demo", "--out", str(tmp_path / "demo")])
    assert isinstance(ended.exception, demo.DemoError)
    assert "found the service gone (" in str(ended.exception)
    assert f"{tmp_path / 'demo' / 'service.log'} says why" in str(ended.exception)
