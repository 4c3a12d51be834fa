"""The command line of every stage."""

from pathlib import Path
from typing import Any

from reconstruction.export.catalogue import FORMATS

OVER_TIME = "frames", "camera", "from_tick", "to_tick"  # options of an export beside its instant


def record_arguments(
    request: dict[str, Any], rig: str, devices: str, recording: Path, keep_free_bytes: int | None = None
) -> list[str]:
    """Return the arguments of `spike4dgs` that make a recording; `rig` is a name in the catalogue or a RIG.toml.

    It leaves `keep_free_bytes` of the disk free, None for as many as the command does by itself.
    """
    options = {"pre_trigger_ms": "pre_trigger", "rejoin_s": "rejoin"}
    given = {options.get(name, name): value for name, value in request.items() if name != "until_stopped"}
    given["keep_free"] = None if keep_free_bytes is None else _megabytes(keep_free_bytes)
    flags = ["--until-stopped"] if request.get("until_stopped") else []
    return ["record", "--rig", rig, "--devices", devices, *_flags(given), *flags, "--out", str(recording)]


def reconstruct_arguments(
    request: dict[str, Any], stage: str, recording: Path, run: Path, restart: dict[str, Any] | None
) -> list[str]:
    """Return the arguments of `spike4dgs` that run one stage of a reconstruction."""
    options = {name: value for name, value in request.items() if name not in ("type", "capture", "views", "follow")}
    if request.get("views"):
        options["views"] = ",".join(request["views"])
    again = ["--again", str(restart["attempt"])] if restart is not None and restart["stage"] == stage else []
    return ["reconstruct", str(recording), "--out", str(run), "--stage", stage, *again, *_flags(options)]


def task_arguments(
    request: dict[str, Any],
    recording: Path,
    run: Path | None,
    out: Path,
    *,
    dark: Path | None = None,
    rig: Path | None = None,
    cameras: Path | None = None,
) -> list[str]:
    """Return the arguments of `spike4dgs` that do any other job; its result is what it prints.

    `dark` is the recording without light of a pixel calibration, `rig` the file that `check-rig` compares with,
    `cameras` the upload that `render` looks from.
    """
    match request["type"]:
        case "images":
            return ["images", str(recording), *_flags({k: request[k] for k in ("method", "ticks")}), "--out", str(out)]
        case "calibrate":
            how = ["--board", request["board"]] if request["board"] else ["--natural"]
            how = ["--pixels", str(recording), str(dark)] if dark is not None else how
            return ["calibrate", str(recording), *how, "--out", str(out / "rig.toml"), "--json"]
        case "check-rig":
            return ["check-rig", str(recording), *([] if rig is None else ["--rig", str(rig)]), "--json"]
        case "verify":
            return ["verify", str(recording), "--json"]
        case "evaluate":
            truth = recording / "truth"
            return ["evaluate", str(run), *(["--truth", str(truth)] if truth.is_dir() else []), "--json"]
        case "render":
            return ["render", str(run), "--cameras", str(cameras), "--out", str(out)]
        case "export":
            options = {"at": request["at_s"], **{name: request.get(name) for name in OVER_TIME}}
            path = out / FORMATS[request["format"]].file
            return ["export", str(run), "--format", request["format"], *_flags(options), "--out", str(path)]
    raise ValueError(request["type"])


def import_arguments(
    request: dict[str, Any], dats: list[Path], cameras: Path, recording: Path, keep_free_bytes: int
) -> list[str]:
    """Return the arguments of `spike4dgs` that make a recording of `.dat` files, named or in the rig's order."""
    names = request["ids"]
    files = [str(dat) if names is None else f"{names[number]}={dat}" for number, dat in enumerate(dats)]
    size = request["size"]
    options = {name: request[name] for name in ("format", "bit_order", "row_order", "poses")}
    options |= {"tick_rate": request["tick_rate_hz"], "size": "x".join(map(str, size)) if size else None}
    options["keep_free"] = _megabytes(keep_free_bytes)
    flags = [f"--{name.replace('_', '-')}" for name in ("allow_partial", "align") if request[name]]
    given = ["--cameras", str(cameras), *_flags(options), *flags, "--out", str(recording)]
    return ["import", *(text for file in files for text in ("--dat", file)), *given]


def look_arguments(request: dict[str, Any], rig: str, devices: str, recording: Path) -> list[str]:
    """Return the arguments of `spike4dgs` that record a few planes, of which simulated cameras store no truth."""
    if devices.startswith("mock:"):
        devices += f"{'&' if '?' in devices else '?'}truth_every={request['ticks']}"
    return record_arguments({"ticks": request["ticks"]}, rig, devices, recording)


def preflight_arguments(request: dict[str, Any], rig: str, devices: str, folder: Path) -> list[str]:
    """Return the arguments of `spike4dgs` that check a rig and the disk of `folder`, where recordings go."""
    options = {"rig": rig, "devices": devices, "out": folder, "disk_seconds": request["disk_seconds"]}
    return ["preflight", *_flags(options), "--json"]


def _flags(options: dict[str, Any]) -> list[str]:
    given = {name: value for name, value in options.items() if value is not None}
    return [text for name, value in given.items() for text in (f"--{name.replace('_', '-')}", str(value))]


def _megabytes(count: int) -> int:
    """Return bytes in whole megabytes, no fewer."""
    return -(-count // 1_000_000)
