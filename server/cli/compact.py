"""`compact`: keeps a recording in a fraction of its space."""

from pathlib import Path

import click

from acquisition.recording.compaction import compact, restore
from server.cli.options import PATH, json_option
from server.cli.output import answer
from server.cli.progress import progress_of


@click.command("compact")
@click.argument("recording", metavar="REC", type=PATH)
@click.option("--undo", is_flag=True, help="Make .dat files again, bit for bit, as other programs read them.")
@json_option
def compact_command(recording: Path, undo: bool, as_json: bool) -> None:
    """Verify a recording, and keep its planes compressed without loss. Every command reads it as before.

    A file is removed when the one in its place was read back from the disk and has the same bits. After a crash the
    recording is whole, and the same command finishes.
    """
    manifest = (restore if undo else compact)(recording, progress_of("compact"))
    cameras = {c.id: {"planes": c.planes, "bytes": c.bytes, "stored_bytes": c.stored_bytes} for c in manifest.cameras}
    size, stored = (sum(camera[name] for camera in cameras.values()) for name in ("bytes", "stored_bytes"))
    document = {"recording": str(recording), "compact": not undo, "bytes": size, "stored_bytes": stored}
    line = f"{recording}: {stored / 1e6:.1f} MB, for {size / 1e6:.1f} MB of planes ({size / stored:.2f} times)"
    answer({**document, "ratio": size / stored, "cameras": cameras}, line, as_json=as_json)
