"""`preflight`: what would spoil a recording, before it is made."""

import json
from pathlib import Path

import click

from acquisition.devices.open import open_cameras, parse_devices
from acquisition.devices.sysfs import SYSFS
from acquisition.errors import BadRecordingError
from acquisition.session.preflight import LATCH_PLANES, Surroundings, camera_facts, preflight
from server.cli.options import load_named_rig
from server.cli.progress import progress_of

_VERDICTS = {True: "pass", False: "FAIL", None: "-"}


@click.command("preflight")
@click.option("--rig", required=True, help="RIG.toml, or a rig of the catalog.")
@click.option("--devices", default="usb:", show_default=True, help="As in record.")
@click.option("--out", type=click.Path(path_type=Path), default=".", help="Folder recordings will go to. [default: .]")
@click.option("--disk-seconds", default=5.0, show_default=True, type=click.FloatRange(min=0.1), help="Disk test.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
def preflight_command(rig: str, devices: str, out: Path, disk_seconds: float, as_json: bool) -> None:
    """Look at cameras, USB, clocks and disk and say what to change, changing nothing: exit 0 ready, 1 not."""
    if not out.is_dir():
        raise BadRecordingError("found no folder", "the one recordings will go to", "make it", where=out)
    simulation = parse_devices(devices)
    around = Surroundings(
        lambda cameras: open_cameras(cameras, simulation, LATCH_PLANES),
        out,
        sysfs=None if simulation else SYSFS,
        disk_seconds=disk_seconds,
    )
    found = load_named_rig(rig)
    checks = preflight(found, around, progress_of("preflight"))
    ready = all(check.passed is not False for check in checks)
    if as_json:
        document = {"rig": found.name, "ready": ready, "checks": [check.to_json() for check in checks]}
        click.echo(json.dumps(document | {"cameras": camera_facts(found, checks)}))
    else:
        for check in checks:
            click.echo(f"{_VERDICTS[check.passed]:5}{check.name}: {check.found} (expected: {check.expected})")
            if check.passed is False:
                click.echo(f"     -> {check.change}")
        click.echo(f"{found.name}: {'ready' if ready else 'not ready'}")
    raise SystemExit(0 if ready else 1)
