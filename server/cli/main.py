"""`spike4dgs`: the command line. Each command is imported only when it is called, so a capture host needs no torch."""

import importlib
import os
import sys
import time
from pathlib import Path

import click

from rigs.errors import Spike4dgsError

COMMANDS = {  # name: (module, what it does)
    "simulate": ("server.cli.acquire", "Record a scene with simulated cameras."),
    "preflight": ("server.cli.preflight", "Say what would spoil a recording, and what to change."),
    "record": ("server.cli.acquire", "Record with the cameras of a rig."),
    "import": ("server.cli.acquire", "Make a recording of .dat files and their cameras."),
    "verify": ("server.cli.acquire", "Check that a recording is whole."),
    "finalise": ("server.cli.acquire", "Finish what a crash left of a recording."),
    "calibrate": ("server.cli.calibrate", "Measure where a rig's cameras stand, their lenses or their pixels."),
    "check-rig": ("server.cli.check_rig", "Say whether a stored calibration still fits a recording."),
    "images": ("server.cli.images", "Turn spikes into images."),
    "reconstruct": ("server.cli.reconstruct", "Turn a recording into moving Gaussians."),
    "render": ("server.cli.reconstruct", "Render a run from any camera at any time."),
    "export": ("server.cli.export", "Write a run in the formats of other tools."),
    "evaluate": ("server.cli.reconstruct", "Compare a run with the truth."),
    "bench": ("server.cli.bench", "Measure speed and quality."),
    "stability": ("server.cli.stability", "Run the stress catalogue on every backend of this machine."),
    "demo": ("server.cli.demo", "The main job on the simulated rig, through the service."),
    "serve": ("server.cli.serve", "Run the web service."),
    "token": ("server.cli.token", "Say who may use a service that others reach."),
    "worker": ("server.cli.serve", "Run queued jobs."),
}


_TRAINING = ("paper", "rasterizer", "training")  # benches


class LazyGroup(click.Group):
    """Finds a command by name and imports its module on first use."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """One line a command, none of them imported."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, line) for name, (_, line) in COMMANDS.items()])

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMANDS:
            return None
        try:
            module = importlib.import_module(COMMANDS[cmd_name][0])
        except ModuleNotFoundError as error:
            if (error.name or "").partition(".")[0] in ("acquisition", "reconstruction", "rigs", "server"):
                raise
            raise click.ClickException(
                f"{cmd_name}: found no package {error.name}, expected it installed; "
                "run pip install 'spike4dgs[reconstruction,server]'"
            ) from error
        return getattr(module, f"{cmd_name.replace('-', '_')}_command")


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(package_name="spike4dgs")
def cli() -> None:
    """From a 3x3 array of spike cameras to a 4D scene one can fly through."""


def _trains(arguments: list[str]) -> bool:
    """Whether one thread pool does all the work: its barriers may spin, which is a third quicker on idle cores.

    Elsewhere (nine simulated cameras, say, each with a pool) spinning takes the cores from those that have work.
    """
    return arguments[:1] == ["reconstruct"] or arguments[:2] in [["bench", b] for b in _TRAINING]


def main() -> None:
    """Console entry: expected errors become one line and an exit code, never a traceback."""
    if not (_trains(sys.argv[1:]) and os.getloadavg()[0] <= (os.cpu_count() or 1) / 2):
        os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    mark = os.environ.pop("SPIKE4DGS_FINISHED", None)  # set by the service around a stage's process
    try:
        cli(obj=time.monotonic())  # a budget counts from here, the heavy imports included
    except SystemExit as end:
        if mark is not None and not end.code:
            sys.stdout.flush()
            Path(mark).touch()
        raise
    except Spike4dgsError as error:
        click.echo(f"spike4dgs: {error}", err=True)
        sys.exit(error.exit_code)
    except OSError as error:
        click.echo(f"spike4dgs: {error.filename or 'system'}: {error.strerror or error}", err=True)
        sys.exit(2)
