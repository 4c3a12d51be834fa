"""`view`: a run in the browser's viewer."""

import sys
from contextlib import suppress
from pathlib import Path

import click
import uvicorn

from server.cli.options import PATH
from server.cli.serve import listening
from server.run_viewer import viewer_app

HOST = "127.0.0.1"


@click.command("view")
@click.argument("run_folder", metavar="RUN", type=PATH)
@click.option("--port", type=click.IntRange(0, 65535), default=0, help="[default: any free one]")
def view_command(run_folder: Path, port: int) -> None:
    """Serve RUN to a browser on this machine, in which one flies through it while it plays.

    The first line printed is the address. Ctrl-C ends it.
    """
    app = viewer_app(run_folder)
    with listening(HOST, port) as listener:
        click.echo(f"http://{HOST}:{listener.getsockname()[1]}")
        sys.stdout.flush()
        config = uvicorn.Config(app, log_level="warning", server_header=False, lifespan="off")
        with suppress(KeyboardInterrupt):  # the usual way to stop it
            uvicorn.Server(config).run(sockets=[listener])
