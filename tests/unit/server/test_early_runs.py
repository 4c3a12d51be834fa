"""Commands that are given a run which ended before it had a scene."""

import pytest
from click.testing import CliRunner

from reconstruction.errors import BadRunError
from reconstruction.run.configuration import ReconstructionConfig
from reconstruction.run.folder import RunFolder
from rigs.exchange.nerfstudio import Frame, dump_frames
from rigs.toml import catalog_rig
from server.cli.main import cli


@pytest.mark.parametrize("stage", ["plan", "points", "train"])
@pytest.mark.parametrize(
    "command",
    [
        ("evaluate",),
        ("render", "--cameras", "path.json", "--out", "frames"),
        ("export", "--format", "ply", "--out", "s.ply"),
    ],
    ids=lambda command: command[0],
)
def test_the_stage_that_a_run_ended_in_is_named(command, stage, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    frame = Frame(catalog_rig("lab3x3").cameras[0], 0.01)
    (tmp_path / "path.json").write_text(dump_frames([frame], ["view.png"]))
    run = RunFolder.start(tmp_path / "run", ReconstructionConfig(holdout="cam11"), tmp_path / "rec", "0123abc")
    for done in ("plan", "poses", "images", "points"):
        if done == stage:
            break
        run.finish_stage(done, 1.0)
    found = CliRunner().invoke(cli, [command[0], "run", *command[1:]]).exception
    assert isinstance(found, BadRunError)
    assert f"run: found no scene: the run ended in its {stage} stage; give its `spike4dgs reconstruct` again" in str(
        found
    )
    assert not {"frames", "s.ply"} & {path.name for path in tmp_path.iterdir()}
