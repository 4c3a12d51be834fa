"""`spike4dgs`: the command line. A command is imported only when it is called, so a capture host needs no torch."""

import importlib
import os
import sys
import time
from pathlib import Path
from typing import NoReturn

import click

from rigs.errors import Spike4dgsError

COMMANDS = {  # name: (module, its line of the help)
    "simulate": ("server.cli.acquire", "Record a scene with simulated cameras."),
    "preflight": ("server.cli.preflight", "Find what would spoil a recording, and tell what to change."),
    "record": ("server.cli.acquire", "Record with the cameras of a rig."),
    "import": ("server.cli.acquire", "Make a recording of .dat files and their cameras."),
    "verify": ("server.cli.acquire", "Check that a recording is whole."),
    "finalise": ("server.cli.acquire", "Finish a recording that a crash interrupted."),
    "compact": ("server.cli.compact", "Keep a recording in a fraction of its space, without loss."),
    "calibrate": ("server.cli.calibrate", "Measure the poses, lenses or pixels of a rig's cameras."),
    "check-rig": ("server.cli.calibrate", "Tell whether a stored calibration still fits a recording."),
    "images": ("server.cli.images", "Turn spikes into images."),
    "reconstruct": ("server.cli.reconstruct", "Turn a recording into moving Gaussians."),
    "render": ("server.cli.reconstruct", "Render a run from any camera at any time."),
    "view": ("server.cli.view", "Fly through a run in a browser."),
    "export": ("server.cli.export", "Write a run in the formats of other tools."),
    "evaluate": ("server.cli.reconstruct", "Compare a run with the truth."),
    "bench": ("server.cli.bench", "Measure speed and quality."),
    "stability": ("server.cli.stability", "Run the stress catalogue on every backend of this machine."),
    "demo": ("server.cli.demo", "Record and reconstruct the simulated rig through the service."),
    "serve": ("server.cli.serve", "Run the web service."),
    "backup": ("server.cli.backup", "Copy what a service knows, while it runs."),
    "restore": ("server.cli.backup", "Put a backup back."),
    "token": ("server.cli.token", "Decide who may use a service that others reach."),
    "worker": ("server.cli.serve", "Run queued jobs."),
}


class LazyGroup(click.Group):
    """Finds a command by its name and imports its module on first use."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write one line for each command and import none."""
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
            found = f"{cmd_name}: found no package {error.name}, expected it installed"
            raise click.ClickException(f"{found}; run pip install 'spike4dgs[reconstruction,server]'") from error
        return getattr(module, f"{cmd_name.replace('-', '_')}_command")


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(package_name="spike4dgs")
def cli() -> None:
    """Turn the spikes of a 3x3 camera array into a 4D scene that one can fly through."""


def _trains(arguments: list[str]) -> bool:
    """Tell whether one thread pool does all the work, so that its barriers may spin: a third faster on idle cores.

    Where there are several pools, as with nine simulated cameras, spinning takes the cores from those that have work.
    """
    if arguments[:1] == ["bench"]:
        from server.cli.bench_runs import BENCHES

        return any(bench.trains for name, bench in BENCHES.items() if arguments[1:2] == [name])
    return arguments[:1] == ["reconstruct"]


def main() -> None:
    """Run a command; an expected error becomes one line and an exit code, never a traceback."""
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
        _fail(error, error.exit_code)
    except OSError as error:
        _fail(Spike4dgsError(error.strerror or str(error), where=error.filename or "system"), 2)


def _fail(error: Spike4dgsError, exit_code: int) -> NoReturn:
    """Report an error in parts to the service, if it started this process, and in the last line to people."""
    from server.cli.progress import report_error

    report_error(error, exit_code)
    click.echo(f"spike4dgs: {error}", err=True)
    sys.exit(exit_code)
