"""Writes a small, made-up result of a reconstruction in its true form, for pages that show one."""

import json
import shutil
from pathlib import Path

import av
import cv2
import numpy as np
from fake_scene import write_scene

from acquisition.durable import write_durably, write_json
from acquisition.recording.importing import ImportOptions, import_recording
from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.packing import pack
from rigs.rig import Rig
from rigs.toml import dump_rig

SIZE = (160, 100)


def write_results(run: Path) -> None:
    """Curve, orbit, thumbnail, and a scene for the viewer."""
    rows = [
        {"seconds": float(s), "steps": 40 * s, "psnr_db": round(33 - 14 * 2 ** (-s / 6), 2)} for s in (2, 4, 8, 16, 32)
    ]
    (run / "error_vs_time.json").write_text(json.dumps({"held_out": "cam11", "rows": rows}))
    write_scene(run, "polynomial")
    (run / "thumbnails").mkdir(exist_ok=True)
    cv2.imwrite(str(run / "thumbnails" / "orbit.png"), frame(0.3))
    with av.open(str(run / "orbit.mp4"), "w") as container:
        stream = container.add_stream("libx264", rate=25)
        stream.width, stream.height, stream.pix_fmt = *SIZE, "yuv420p"
        for i in range(50):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame(i / 50), format="bgr24")))
        container.mux(stream.encode())


def write_preview(run: Path, steps: int) -> None:
    """Picture of a training after so many steps: a ball that is elsewhere each time."""
    write_durably(run / "preview.png", cv2.imencode(".png", frame(steps / 700))[1].tobytes())
    write_json(run / "preview.json", {"camera": "cam11", "steps": steps})


def frame(turn: float) -> np.ndarray:
    """A ball that goes round, uint8 [H, W, 3]."""
    picture = np.full((SIZE[1], SIZE[0], 3), 40, np.uint8)
    centre = (80 + 50 * np.cos(2 * np.pi * turn), 50 + 20 * np.sin(2 * np.pi * turn))
    cv2.circle(picture, tuple(int(c) for c in centre), 14, (210, 210, 210), -1)
    return picture


def write_recording(out: Path, rig: Rig, ticks: int) -> None:
    """A recording that can be read: each camera's left part is dark, the more the later its place in the grid."""
    folder = out.with_name(f".{out.name}.dats")
    folder.mkdir()
    for number, camera in enumerate(rig.cameras):
        planes = np.zeros((ticks, camera.height, camera.width), np.uint8)
        planes[::2, :, 40 * number :] = 1
        (folder / f"{camera.id}.dat").write_bytes(pack(planes, PlaneLayout(camera.width, camera.height)).tobytes())
    (folder / "rig.toml").write_text(dump_rig(rig))
    dats = [f"{camera.id}={folder / camera.id}.dat" for camera in rig.cameras]
    import_recording(dats, folder / "rig.toml", out, ImportOptions(rig.tick_rate_hz))
    shutil.rmtree(folder)
