"""Stands in for `spike4dgs record` and `spike4dgs reconstruct --stage`: counts steps, checkpoints, obeys SIGTERM.

FAKE_STEPS and FAKE_STEP_S set the length of the train stage; a stage fails while DATA/jobs/fail-STAGE exists.
"""

import json
import os
import signal
import sys
import time
from pathlib import Path

from rigs.toml import catalog_rig, dump_rig

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


def record_until_told(out: Path) -> None:
    told: list[bool] = []
    signal.signal(signal.SIGTERM, lambda *_: told.append(True))
    time.sleep(0.6)  # what comes sooner after another report is not kept
    report(0.0, "armed")
    sys.stdin.readline()
    time.sleep(0.6)
    report(0.5, "saved")
    while not told:
        time.sleep(0.02)
    out.mkdir()
    (out / "rig.toml").write_text(dump_rig(catalog_rig("lab3x3")))
    (out / "recording.json").write_text(json.dumps({"saved": True}))


def record(out: Path, ticks: int) -> None:
    if ticks == 13:
        sys.exit("spike4dgs: cam11: found no answer, expected a camera; plug it in")
    aside = out.with_name(f".{out.name}.aside")
    aside.mkdir(exist_ok=True)
    report(0.5, "recording")
    time.sleep(0.4 if ticks < 1000 else 30)
    (aside / "rig.toml").write_text(dump_rig(catalog_rig("lab3x3")))
    (aside / "recording.json").write_text(json.dumps({"ticks": ticks}))
    aside.rename(out)


def train(run: Path, steps: int, step_s: float) -> None:
    told = []
    signal.signal(signal.SIGTERM, lambda *_: told.append(True))
    checkpoint = run / "checkpoint.json"
    done = json.loads(checkpoint.read_text())["done"] if checkpoint.exists() else 0
    with (run / "attempts.txt").open("a") as attempts:
        attempts.write(f"{os.getpid()} {done}\n")
    while done < steps:
        time.sleep(step_s)
        done += 1
        aside = checkpoint.with_suffix(".aside")
        aside.write_text(json.dumps({"done": done}))
        aside.replace(checkpoint)
        report(done / steps, f"step {done}")
        if told:
            sys.stderr.write("stopped with a checkpoint\n")
            sys.exit(143)


def main() -> None:
    command, *arguments = sys.argv[1:]
    if command in ("verify", "check-rig"):
        sys.stdout.write(json.dumps({"asked": command, "sound": False}))
        sys.exit(1)
    if "--until-stopped" in arguments:
        return record_until_told(Path(arguments[arguments.index("--out") + 1]))
    flags = dict(
        zip(arguments[command == "reconstruct" :][::2], arguments[command == "reconstruct" :][1::2], strict=True)
    )
    if command == "record":
        return record(Path(flags["--out"]), int(flags["--ticks"]))
    run, stage = Path(flags["--out"]), flags["--stage"]
    run.mkdir(exist_ok=True)
    sys.stderr.write(f"arguments {' '.join(arguments[3:])}\n")
    if (run.parents[1] / f"fail-{stage}").exists():
        sys.exit(f"spike4dgs: {stage}: found a fault, expected none; mend it")
    if stage == "train":
        train(run, int(os.environ.get("FAKE_STEPS", "10")), float(os.environ.get("FAKE_STEP_S", "0.02")))
    if stage == "report":
        (run / "metrics.json").write_text(json.dumps(METRICS))
        (run / "report.html").write_text("<title>report</title>")
        (run / "run.json").write_text("{}")
        (run / "thumbnails").mkdir(exist_ok=True)
        (run / "thumbnails" / "render_000120.png").write_bytes(b"\x89PNG")
    (run / f"{stage}.done").write_text("")
    return None


main()
