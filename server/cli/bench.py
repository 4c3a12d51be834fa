"""`bench`: measurements one can repeat, as one JSON document, a table and a plot."""

import json
import tempfile
from pathlib import Path
from typing import Any

import click

from acquisition.durable import write_json
from acquisition.scenes.digest import committed_digests, scenes_digest
from server.cli.bench_runs import BENCHES, Asked


@click.command("bench")
@click.argument("name", type=click.Choice(sorted(BENCHES)))
@click.option("--scene", "scenes", help="NAME,... [default: the evaluation scenes; pixels: fan_and_ball].")
@click.option("--quick", is_flag=True, help="One seed, one budget, one scene and no sweeps; seconds of recording.")
@click.option(
    "--metric-files",
    type=click.Path(path_type=Path, exists=True, file_okay=False),
    help="Folder of parameters for the images' metrics: alexnet*.pth (LPIPS), brisque_model_live.yml and "
    "brisque_range_live.yml (BRISQUE), niqe_pris_params.npz (NIQE).",
)
@click.option("--table", "tables", help="paper: NAME,... of its tables [default: all, by priority].")
@click.option("--limit-s", type=click.FloatRange(min=0), help="leave-out, paper: begin nothing after so many seconds.")
@click.option("--keep", is_flag=True, help="paper: take results of other code as they are; their rows say so.")
@click.option("--out", type=click.Path(path_type=Path), help="Folder for NAME.json and NAME.png; resumes there.")
@click.option("--json", "as_json", is_flag=True, help="Print the document as JSON.")
def bench_command(name: str, out: Path | None, as_json: bool, **asked: Any) -> None:
    """Measure NAME.

    images, leave-out (plans against everything on), paper (all its tables), pixels (calibrated or not), poses (of the
    cameras), rasterizer, recorder (on the disk of --out), training, viewpoints (that nobody captured).
    """
    with tempfile.TemporaryDirectory(dir=None if out or name != "recorder" else Path.cwd()) as spare:
        bench = BENCHES[name](Asked(out / "work" if out else Path(spare), **asked))
        document = bench.run()
        document.scenes = scenes_digest(committed_digests())
        found = document.to_json()
        if out:
            out.mkdir(parents=True, exist_ok=True)
            write_json(out / f"{name}.json", found)
            bench.draw(out, found)
    click.echo(json.dumps(found) if as_json else _table(found))


def _table(document: dict) -> str:
    width = max(len(key) for key in document["summary"])
    lines = [f"{key:{width}}  {value:.6g}" for key, value in document["summary"].items()]
    return "\n".join([*lines, *(f"left out: {o}" for o in document["omissions"])])
