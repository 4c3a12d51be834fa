"""Stands in for `spike4dgs record` and `spike4dgs reconstruct --stage`: counts steps, checkpoints, obeys SIGTERM.

FAKE_STEPS and FAKE_STEP_S set the length of the train stage; a stage fails while DATA/jobs/fail-STAGE exists.
With FAKE_RESULTS a reconstruction leaves what a page shows of one.
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
    while done < steps:
        time.sleep(step_s)
        done += 1
        aside = checkpoint.with_suffix(".aside")
        aside.write_text(json.dumps({"done": done}))
        aside.replace(checkpoint)
        report(done / steps, f"step {done}, loss {1 / done:.4f}, PSNR {20 + 10 * done / steps:.2f} dB, 900 Gaussians")
        if told:
            sys.stderr.write("stopped with a checkpoint\n")
            sys.exit(143)


def main() -> None:
    command, *arguments = sys.argv[1:]
    if "--until-stopped" in arguments:
        return record_until_stopped(Path(arguments[arguments.index("--out") + 1]))
    if command == "verify":
        sys.stdout.write(json.dumps({"recording": arguments[0], "sound": True, "damages": [], "reason": None}))
        return None
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
        if "FAKE_RESULTS" in os.environ:
            from fake_results import write_results

            write_results(run)
        (run / "run.json").write_text("{}")
    (run / f"{stage}.done").write_text("")
    return None


main()
