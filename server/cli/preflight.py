"""`preflight`: find what would spoil a recording before it is made."""

from pathlib import Path

import click

from acquisition.devices.open import open_cameras, parse_devices
from acquisition.devices.sysfs import SYSFS
from acquisition.errors import BadRecordingError
from acquisition.session.preflight import LATCH_PLANES, Surroundings, camera_facts, preflight
from server.cli.options import PATH, json_option, load_named_rig
from server.cli.output import answer
from server.cli.progress import progress_of

_VERDICTS = {True: "pass", False: "FAIL", None: "-"}


@click.command("preflight")
@click.option("--rig", required=True, help="RIG.toml, or a rig of the catalog.")
@click.option("--devices", default="usb:", show_default=True, help="As in record.")
@click.option("--out", type=PATH, default=".", help="Folder recordings will go to. [default: .]")
@click.option(
    "--disk-seconds", default=5.0, show_default=True, type=click.FloatRange(min=0.1), help="Of the disk test."
)
@json_option
def preflight_command(rig: str, devices: str, out: Path, disk_seconds: float, as_json: bool) -> None:
    """Check cameras, USB, clocks and disk, and tell what to change. It changes nothing. Exit 0: ready, 1: not."""
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
    document = {"rig": found.name, "ready": ready, "checks": [check.to_json() for check in checks]}
    lines = []
    for check in checks:
        lines.append(f"{_VERDICTS[check.passed]:5}{check.name}: {check.found} (expected: {check.expected})")
        lines += [f"     -> {check.change}"] if check.passed is False else []
    lines.append(f"{found.name}: {'ready' if ready else 'not ready'}")
    answer(document | {"cameras": camera_facts(found, checks)}, "\n".join(lines), as_json=as_json)
    raise SystemExit(0 if ready else 1)
