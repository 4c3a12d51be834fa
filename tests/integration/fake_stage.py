"""Stands in for `spike4dgs record` and `spike4dgs reconstruct --stage`: counts steps, checkpoints, obeys SIGTERM.

It also calibrates, by lengthening each lens by a tenth, and checks rigs. Imports are true ones.

FAKE_STEPS and FAKE_STEP_S set the length of the train stage; a stage fails while DATA/jobs/fail-STAGE exists, and
refuses its input while DATA/jobs/refuse-STAGE does. Training does not end while DATA/jobs/hold-train exists.
With FAKE_RESULTS a reconstruction leaves what a page shows of one, and recordings can be read; its training draws what
it has learnt every PREVIEW_EVERY steps.
"""

import json
import os
import shutil
import signal
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import NoReturn

from rigs.rig import Calibration
from rigs.toml import catalog_rig, dump_rig, load_rig

PREVIEW_EVERY = 100
METRICS = {
    "psnr_db": 32.5,
    "ssim": 0.95,
    "abs_rel": 0.012,
    "delta_1_25": 0.99,
    "nearest_view.psnr_db": 17.0,
    "nearest_view.ssim": 0.4,
    "nearest_view.abs_rel": 0.1,
    "nearest_view.delta_1_25": 0.9,
    "depth_blend.psnr_db": 30.0,
    "depth_blend.ssim": 0.9,
    "depth_blend.abs_rel": 0.03,
    "depth_blend.delta_1_25": 0.97,
}


def report(fraction: float, message: str) -> None:
    event = {"event": "progress", "stage": "x", "fraction": fraction, "message": message}
    sys.stderr.write(json.dumps(event) + "\n")


def fail(found: str, expected: str, do: str, where: str = "", *, bad_input: bool = False, kind: str = "") -> NoReturn:
    parts = {"kind": kind, "found": found, "expected": expected, "do": do, "where": where, "bad_input": bad_input}
    sys.stderr.write(json.dumps({"event": "error", **parts, "exit_code": 1}) + "\n")
    sys.exit(f"spike4dgs: {where}: {found}")


def record_until_told(out: Path) -> None:
    told: list[bool] = []
    unsaved = "stopped before it was told to save, so nothing was kept"
    signal.signal(signal.SIGTERM, lambda *_: fail(unsaved, "", "", kind="StoppedError"))
    time.sleep(0.6)  # what comes sooner after another report is not kept
    report(0.0, "armed")
    sys.stdin.readline()
    signal.signal(signal.SIGTERM, lambda *_: told.append(True))
    time.sleep(0.6)
    report(0.5, "saved")
    while not told:
        time.sleep(0.02)
    if "FAKE_RESULTS" in os.environ:
        return record(out, 40)
    out.mkdir()
    (out / "rig.toml").write_text(dump_rig(catalog_rig("lab3x3")))
    (out / "recording.json").write_text(json.dumps({"saved": True}))
    return None


def record(out: Path, ticks: int, rig_name: str = "lab3x3") -> None:
    if ticks == 13:
        fail("found no answer", "a camera", "plug it in", "cam11")
    aside = out.with_name(f".{out.name}.aside")
    aside.mkdir(exist_ok=True)
    report(0.5, "recording")
    time.sleep(0.4 if ticks < 1000 else 30)
    rig = load_rig(Path(rig_name)) if rig_name.endswith(".toml") else catalog_rig(rig_name)
    if "FAKE_RESULTS" in os.environ:
        from fake_results import write_recording

        return write_recording(out, rig, ticks)
    for camera in rig.cameras:
        if camera.pixels:
            shutil.copy(camera.pixels, aside)
    (aside / "rig.toml").write_text(dump_rig(rig))
    (aside / "recording.json").write_text(json.dumps({"ticks": ticks}))
    aside.rename(out)
    return None


def record_until_stopped(out: Path) -> None:
    told = []
    signal.signal(signal.SIGTERM, lambda *_: told.append(True))
    for i in range(3000):
        if told:
            break
        report(0.0, f"{i} planes")
        time.sleep(0.02)
    record(out, 40)


def train(run: Path, steps: int, step_s: float) -> None:
    told = []
    signal.signal(signal.SIGTERM, lambda *_: told.append(True))
    checkpoint = run / "checkpoint.json"
    done = json.loads(checkpoint.read_text())["done"] if checkpoint.exists() else 0
    with (run / "attempts.txt").open("a") as attempts:
        attempts.write(f"{os.getpid()} {done}\n")
    while done < steps or (run.parents[1] / "hold-train").exists():
        if done % PREVIEW_EVERY == 0 and "FAKE_RESULTS" in os.environ:
            from fake_results import write_preview

            write_preview(run, done)
        time.sleep(step_s)
        done += 1
        aside = checkpoint.with_suffix(".aside")
        aside.write_text(json.dumps({"done": done}))
        aside.replace(checkpoint)
        share = min(1.0, done / steps)
        close = f"loss {1 / done:.4f}, training PSNR {20 + 10 * share:.2f} dB"
        report(share, f"step {done}, {close}, 900 Gaussians")
        if told:
            sys.stderr.write("stopped with a checkpoint\n")
            sys.exit(143)


def calibrate(recording: Path, options: list[str]) -> None:
    out = Path(options[options.index("--out") + 1])
    sys.stderr.write(f"arguments {' '.join(options)}\n")
    fault = out.parents[2] / "fail-calibrate"
    if fault.exists():
        fail("found 3 tracks", "250", "show more")
    rig, document = load_rig(recording / "rig.toml"), {"rig": str(out), "cameras": {}}
    if "--pixels" in options:
        rig = replace(rig, cameras=tuple(replace(c, pixels=pixels_beside(out, c.id)) for c in rig.cameras))
    else:
        found = (replace(c, fx=1.1 * c.fx, fy=1.1 * c.fy) for c in rig.cameras)
        rig = replace(rig, cameras=tuple(found), poses="calibrated", calibration=Calibration("2026-11-21", 0.1, 0.01))
        sds = {"rotation_deg_sd": 0.01, "center_m_sd": 1e-4, "focal_percent_sd": 0.1}
        document["cameras"] = {c: {"points": 9, "residual_px": 0.1, **sds} for c in rig.ids}
        out.with_name("rig-residuals.png").write_bytes(b"\x89PNG\r\n")
    out.write_text(dump_rig(rig))
    sys.stdout.write(json.dumps(document))


def pixels_beside(out: Path, camera_id: str) -> Path:
    path = out.with_name(f"rig-{camera_id}-pixels.npz")
    path.write_bytes(camera_id.encode())
    return path


def check_rig(options: list[str]) -> None:
    rig = load_rig(Path(options[options.index("--rig") + 1]))
    sys.stdout.write(json.dumps({"fits": False, "fx": rig.cameras[0].fx}))
    sys.exit(1)


def preflight() -> None:
    disk = {"name": "disk speed", "passed": False, "found": "9 MB/s", "expected": "99 MB/s", "change": "a faster disk"}
    camera = {"id": "cam00", "connected": True, "serial": "S-1"}
    sys.stdout.write(json.dumps({"rig": "lab3x3", "ready": False, "checks": [disk], "cameras": [camera]}))
    sys.exit(1)


def main() -> None:
    command, *arguments = sys.argv[1:]
    if command == "calibrate":
        return calibrate(Path(arguments[0]), arguments[1:])
    if command == "check-rig" and "--rig" in arguments:
        return check_rig(arguments[1:])
    if command == "import":  # by the command itself
        os.execv(sys.executable, [sys.executable, "-m", "server.cli", *sys.argv[1:]])
    if command == "preflight":
        return preflight()
    if command in ("verify", "check-rig"):
        sound = "FAKE_RESULTS" in os.environ
        sys.stdout.write(json.dumps({"asked": command, "sound": sound, "damages": [], "reason": None}))
        sys.exit(0 if sound else 1)
    if "--until-stopped" in arguments:
        until = record_until_told if "--pre-trigger" in arguments else record_until_stopped
        return until(Path(arguments[arguments.index("--out") + 1]))
    flags = dict(
        zip(arguments[command == "reconstruct" :][::2], arguments[command == "reconstruct" :][1::2], strict=True)
    )
    if command == "record":
        return record(Path(flags["--out"]), int(flags["--ticks"]), flags["--rig"])
    run, stage = Path(flags["--out"]), flags["--stage"]
    run.mkdir(exist_ok=True)
    sys.stderr.write(f"arguments {' '.join(arguments[3:])}\n")
    if (run.parents[1] / f"fail-{stage}").exists():
        fail("found a fault", "none", "mend it", stage)
    if (run.parents[1] / f"refuse-{stage}").exists():
        fail("found a dark scene", "some light", "change --tick-stride", stage, bad_input=True)
    if stage == "train":
        train(run, int(os.environ.get("FAKE_STEPS", "10")), float(os.environ.get("FAKE_STEP_S", "0.02")))
    if stage == "report":
        (run / "metrics.json").write_text(json.dumps(METRICS))
        (run / "report.html").write_text("<title>report</title>")
        if "FAKE_RESULTS" in os.environ:
            from fake_results import write_results

            write_results(run)
        (run / "run.json").write_text("{}")
        (run / "thumbnails").mkdir(exist_ok=True)
        (run / "thumbnails" / "render_000120.png").write_bytes(b"\x89PNG")
    (run / f"{stage}.done").write_text("")
    return None


main()
