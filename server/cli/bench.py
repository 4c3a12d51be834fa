"""`bench`: measurements one can repeat, as one JSON document, a table and a plot."""

import tempfile
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import click

from acquisition.durable import write_json
from acquisition.scenes.digest import committed_digests, scenes_digest
from acquisition.scenes.looks import LOOKS, NO_REASON, add_looks, looks_of
from server.cli.bench_asked import Asked
from server.cli.bench_runs import BENCHES
from server.cli.options import PATH, json_option
from server.cli.output import answer, columns
from server.cli.progress import progress_of

_NAMES = columns([(name, bench.about) for name, bench in BENCHES.items()])


@click.command("bench", help=f"Measure NAME.\n\n\b\n{_NAMES}")
@click.argument("name", type=click.Choice(list(BENCHES)), metavar="NAME")
@click.option(
    "--scene",
    "--scenes",
    "scenes",
    help="NAME,... or `realistic` [default: the bench's own]. pixels takes one; rivals and long keep their runs on "
    "others; rasterizer, recorder and leave-out have none.",
)
@click.option("--quick", is_flag=True, help="One seed, one budget, one scene and no sweeps; seconds of recording.")
@click.option(
    "--metric-files",
    type=click.Path(path_type=Path, exists=True, file_okay=False),
    help="Folder of parameters for the images' metrics: alexnet*.pth (LPIPS), brisque_model_live.yml and "
    "brisque_range_live.yml (BRISQUE), niqe_pris_params.npz (NIQE).",
)
@click.option(
    "--table",
    "tables",
    help="paper, rivals: NAME,... of the tables whose runs are begun [default: all, by priority]; other rows are kept.",
)
@click.option(
    "--limit-s",
    type=click.FloatRange(min=0),
    help="Benches of many runs: begin nothing after so many seconds.",
)
@click.option("--keep", is_flag=True, help="Benches of many runs: keep results of other code; their rows say so.")
@click.option(
    "--against",
    metavar="COMMAND",
    type=click.Path(path_type=Path, exists=True, dir_okay=False, executable=True),
    help="speed, large: the installed spike4dgs of an older revision [default: this revision is measured alone].",
)
@click.option("--reason", default=NO_REASON, help="Why evaluation scenes are looked at; looks.jsonl of --out keeps it.")
@click.option("--out", type=PATH, help="Folder for NAME.json and NAME.png; an interrupted bench resumes there.")
@json_option
def bench_command(name: str, out: Path | None, reason: str, as_json: bool, **options: Any) -> None:
    """Run a bench, keep its document and pictures, and print its summary."""
    bench = BENCHES[name]
    # The recorder is measured on the disk of this folder, not on that of the temporary ones.
    with tempfile.TemporaryDirectory(dir=None if out or name != "recorder" else Path.cwd()) as spare:
        earlier = out / f"{name}.json" if out else None
        asked = Asked(out / "work" if out else Path(spare), progress_of, earlier, **options)
        document = bench.run(asked)
        document.scenes = scenes_digest(committed_digests())
        found = document.to_json()
        if out:
            out.mkdir(parents=True, exist_ok=True)
            write_json(out / f"{name}.json", found)
            if not asked.quick:
                day = datetime.now(UTC).date().isoformat()
                add_looks(out / LOOKS, looks_of(found, day, reason))
            bench.draw(asked, out, found)
    summary = columns([(key, f"{value:.6g}") for key, value in found["summary"].items()])
    answer(found, "\n".join([summary, *(f"left out: {o}" for o in found["omissions"])]), as_json=as_json)
