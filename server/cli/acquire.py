"""Commands that make and check recordings: simulate, record, import, verify."""

import dataclasses
from pathlib import Path

import click

from acquisition.devices import open as limits
from acquisition.devices.open import Simulation, nested_in
from acquisition.devices.registers import EXPOSURES, THRESHOLDS, Sensitivity
from acquisition.errors import BadRecordingError, IncompleteError
from acquisition.recording.finalise import finalise
from acquisition.recording.importing import FORMATS, TRAILING_COLUMNS, ImportOptions, import_recording
from acquisition.recording.manifest import Manifest
from acquisition.recording.reader import read_manifest
from acquisition.recording.spikecv import read_size, write_config
from acquisition.recording.verify import verify
from acquisition.scenes.catalog import PURPOSES, SCENES
from acquisition.scenes.glass import Glass
from acquisition.session.record import Take, record, simulate
from acquisition.spikes.sensor import SENSOR_KINDS
from acquisition.spikes.traits import Traits
from server.cli.operator import operator_control
from server.cli.options import PATH, json_option, keep_free, load_named_rig, new_recording, numbers_of, parse_size
from server.cli.output import answer, warn
from server.cli.progress import progress_of
from server.cli.skews import began_by_light, skew_doubt

MIN_RATE_HZ, MAX_RATE_HZ = 100.0, 1e6  # planes a second that `simulate` takes


class ManyDats(click.Command):
    """Lets `--dat` take all files up to the next option, so that a shell pattern works."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Repeat the option before each of its files."""
        spread, taking = [], False
        for arg in args:
            if arg.startswith("-"):
                taking = arg == "--dat"
                spread += [] if taking else [arg]
            else:
                spread += ["--dat", arg] if taking else [arg]
        return super().parse_args(ctx, spread)


_SCENES_HELP = "; ".join(f"{purpose}: {' '.join(names)}" for purpose, names in PURPOSES)


@click.command("simulate")
@click.option("--scene", type=click.Choice(tuple(SCENES)), metavar="NAME", required=True, help=_SCENES_HELP)
@click.option("--rig", default="lab3x3", show_default=True, help="RIG.toml, or a rig of the catalog.")
@click.option("--ticks", default=400, show_default=True, type=click.IntRange(min=1), help="Planes from every camera.")
@click.option("--size", type=parse_size, metavar="WxH", help="Pixels of every camera; the rig's intrinsics are scaled.")
@click.option("--seed", default=0, show_default=True, type=click.IntRange(min=0))
@click.option(
    "--sensor",
    default="real",
    show_default=True,
    type=click.Choice(SENSOR_KINDS),
    help="The harsh one has all of the traits below, as real sensors have them.",
)
@numbers_of(Traits)
@click.option(
    "--camera-gains",
    default=0.0,
    show_default=True,
    type=click.FloatRange(0, limits.MOST_GAINS),
    help="Spread the gain of the cameras by this share (standard deviation).",
)
@click.option(
    "--camera-lags",
    default=0.0,
    show_default=True,
    type=click.FloatRange(0, limits.MOST_LAGS),
    help="Let cameras see up to so many ticks early or late.",
)
@click.option(
    "--lens",
    default="",
    metavar="BEND",
    help="Bend by 10% at the corners (negative: pincushion), or by OpenCV's k1,k2[,p1,p2[,k3]]. Not in the rig file.",
)
@numbers_of(Glass)
@click.option(
    "--samples",
    default=2,
    show_default=True,
    type=click.IntRange(min=1, max=limits.MOST_SAMPLES),
    help="Rays along a side of a pixel that changes; the truth, and pixels that do not change, have 4 or more. Scenes "
    "of a path tracer have their own number.",
)
@click.option(
    "--truth-every",
    type=click.IntRange(min=1),
    metavar="PLANES",
    help="Planes between true frames.  [default: 20; more where 4000 planes are exceeded, so that 200 frames are kept]",
)
@click.option(
    "--rig-error",
    default=0.0,
    show_default=True,
    type=click.FloatRange(0, limits.MOST_RIG_ERROR),
    help="Put the cameras off the rig file by so many degrees, cm and percent of the focal length; it is then nominal.",
)
@click.option(
    "--rate",
    "rate_hz",
    type=click.FloatRange(MIN_RATE_HZ, MAX_RATE_HZ),
    metavar="HZ",
    help="Planes a second instead of the rig's. Thresholds grow with the tick: white stays as many spikes a tick.",
)
@click.option(
    "--light",
    default=1.0,
    show_default=True,
    type=click.FloatRange(0, limits.MOST_LIGHT, min_open=True),
    help="Factor of the scene's light; 2 at half the --rate is the same light on the same thresholds.",
)
@click.option("--spikecv", is_flag=True, help="Also write the config.yaml that SpikeCV reads.")
@new_recording
@json_option
def simulate_command(
    scene: str,
    rig: str,
    ticks: int,
    size: tuple[int, int] | None,
    rate_hz: float | None,
    spikecv: bool,
    out: Path,
    as_json: bool,
    **simulation,
) -> None:
    """Record a simulated scene, with its ground truth beside the spikes."""
    found = load_named_rig(rig)
    found = found.scaled(*size) if size else found
    found = dataclasses.replace(found, tick_rate_hz=rate_hz) if rate_hz else found
    manifest = simulate(Simulation(scene, **nested_in(simulation)), found, ticks, out, progress_of("simulate"))
    if spikecv:
        write_config(out, manifest)
    _print_recording(out, manifest, as_json)


@click.command("record")
@click.option("--rig", required=True, help="RIG.toml, or a rig of the catalog.")
@click.option("--ticks", type=click.IntRange(min=1), help="Planes from every camera.")
@click.option("--until-stopped", is_flag=True, help="Record until SIGINT (Ctrl-C) or SIGTERM.")
@click.option(
    "--pre-trigger",
    "pre_trigger_ms",
    type=click.FloatRange(min=0, min_open=True),
    metavar="MS",
    help="Keep the last MS ms in memory; Enter (a line on standard input) saves them and records on.",
)
@keep_free(256)
@click.option("--threshold", type=click.IntRange(*THRESHOLDS), help="Charge of a spike, in thousandths of the nominal.")
@click.option("--exposure", type=click.IntRange(*EXPOSURES), help="Part of a tick that gathers light, in thousandths.")
@click.option(
    "--rejoin",
    "rejoin_s",
    default=5.0,
    show_default=True,
    type=click.FloatRange(0, 50),
    metavar="S",
    help="Reset a lost camera and look for it for S seconds; 0 gives it up at once.",
)
@click.option(
    "--devices",
    default="usb:",
    show_default=True,
    help="usb:, mock:SCENE?seed=0&sensor=real&samples=2&truth_every=20&fault=KIND:camRC&profile=NAME, or replay:REC",
)
@new_recording
@json_option
def record_command(
    rig: str,
    ticks: int | None,
    until_stopped: bool,
    pre_trigger_ms: float | None,
    keep_free_bytes: int,
    threshold: int | None,
    exposure: int | None,
    rejoin_s: float,
    devices: str,
    out: Path,
    as_json: bool,
) -> None:
    """Arm all cameras of a rig, start them together, and record.

    If a camera fails, the others record on: the recording is kept, marked incomplete, and the exit code is 1. The same
    holds when Ctrl-C ends a run of --ticks. --threshold and --exposure stay in the cameras until they are set again.
    """
    if (ticks is None) != until_stopped:
        raise click.UsageError("expected either --ticks N or --until-stopped")
    chosen = threshold is not None or exposure is not None
    sensitivity = Sensitivity(threshold or 1000, 1000 if exposure is None else exposure) if chosen else None
    with operator_control(saves=pre_trigger_ms is not None) as control:
        take = Take(ticks, pre_trigger_ms, keep_free_bytes, control, sensitivity, rejoin_s)
        try:
            manifest = record(load_named_rig(rig), devices, take, out, progress_of("record"))
        except IncompleteError:
            _warn_of_skews(read_manifest(out))
            raise
    _print_recording(out, manifest, as_json)


_POSES_HELP = "Nominal ones, of a drawing, are found from the scene.  [default: as RIG.toml says, else calibrated]"
_ALIGN_HELP = (
    "Find when each camera began from changes of light they all see, and leave out what was sent before all had."
)
_FORMATS_HELP = "Rows of pixels; rows with 16 more bits each; M1K40 segments, decoded to plain planes."


@click.command("import", cls=ManyDats)
@click.option("--dat", "dats", multiple=True, required=True, metavar="FILE...", help="In row order, or camRC=FILE.")
@click.option("--cameras", type=PATH, required=True, help="transforms.json, a COLMAP model folder, or RIG.toml.")
@click.option("--tick-rate", "tick_rate_hz", type=float, required=True, help="Planes a second.")
@click.option("--poses", type=click.Choice(["calibrated", "nominal"]), help=_POSES_HELP)
@click.option("--size", type=parse_size, metavar="WxH", help="Pixels of every camera, if the cameras' file has none.")
@click.option("--spikecv", type=PATH, help="SpikeCV's config.yaml, which has the size.")
@click.option("--format", type=click.Choice(FORMATS), default="vidar", show_default=True, help=_FORMATS_HELP)
@click.option("--bit-order", type=click.Choice(["lsb", "msb"]), help="[default: lsb]")
@click.option("--row-order", type=click.Choice(["bottom", "top"]), help="The row stored first. [default: bottom]")
@click.option("--allow-partial", is_flag=True, help="Drop an incomplete last plane, and record its size.")
@click.option("--align", is_flag=True, help=_ALIGN_HELP)
@keep_free(1)
@new_recording
@json_option
def import_command(
    dats: tuple[str, ...],
    cameras: Path,
    size: tuple[int, int] | None,
    spikecv: Path | None,
    align: bool,
    out: Path,
    as_json: bool,
    **options,
) -> None:
    """Make a recording of `.dat` files. All but M1K40 ones, which are decoded to plain planes, stay bit for bit."""
    if spikecv:
        size = _size_of(spikecv, size, options["format"])
    chosen = ImportOptions(size=size, **options)
    found = began_by_light if align else None
    manifest = import_recording(dats, cameras, out, chosen, progress_of("import"), warn=warn, align=found)
    _print_recording(out, manifest, as_json)
    if not as_json and chosen.poses is None and cameras.suffix == ".json":
        click.echo(f"poses: those of {cameras.name} count as calibrated; give --poses nominal where it is a drawing")


@click.command("verify")
@click.argument("recording", metavar="REC", type=PATH)
@json_option
def verify_command(recording: Path, as_json: bool) -> None:
    """Check every byte of a recording: exit 0 sound, 1 damaged, 2 no recording."""
    damages = verify(recording, progress_of("verify"))
    reason = read_manifest(recording).reason
    found = [dataclasses.asdict(damaged) for damaged in damages]
    document = {"recording": str(recording), "sound": not damages, "damages": found, "reason": reason}
    sound = f"{recording}: sound, incomplete: {reason}" if reason else f"{recording}: sound"
    answer(document, "\n".join(map(str, damages)) or sound, as_json=as_json)
    raise SystemExit(1 if damages else 0)


@click.command("finalise")
@click.argument("recording", metavar="REC", type=PATH)
@json_option
def finalise_command(recording: Path, as_json: bool) -> None:
    """Finish a recording after a crash: keep the blocks that its journal proves. A finished one stays as it is."""
    found = finalise(recording, progress_of("finalise"))
    _print_recording(found.path, found.manifest, as_json)


def _size_of(spikecv: Path, size: tuple[int, int] | None, source_format: str) -> tuple[int, int]:
    """Return width and height in pixels of a config.yaml. It counts stored columns, but those of M1K40 as pixels."""
    width, height = read_size(spikecv)
    found = width - TRAILING_COLUMNS.get(source_format, 0), height
    if size and size != found:
        expected = f"the --size {size[0]}x{size[1]}"
        raise BadRecordingError(f"found {found[0]}x{found[1]} pixels", expected, "leave one out", where=spikecv)
    return found


def _print_recording(out: Path, manifest: Manifest, as_json: bool) -> None:
    cameras = {camera.id: {"planes": camera.planes, "drops": camera.drops} for camera in manifest.cameras}
    facts = {name: getattr(manifest, name) for name in ("tick_rate_hz", "status", "reason")}
    lost = sum(sum(camera.drops.values()) for camera in manifest.cameras)
    counts = sorted(camera.planes for camera in manifest.cameras)
    planes = f"{counts[0]} planes each" if counts[0] == counts[-1] else f"{counts[0]} to {counts[-1]} planes"
    line = f"{out}: {len(cameras)} cameras, {planes} at {manifest.tick_rate_hz:g} Hz, {lost} planes lost"
    line += f"; incomplete: {manifest.reason}" if manifest.reason else ""
    _warn_of_skews(manifest)
    answer({"recording": str(out), **facts, "cameras": cameras}, line, as_json=as_json)


def _warn_of_skews(manifest: Manifest) -> None:
    if doubt := skew_doubt(manifest):
        warn(doubt)
