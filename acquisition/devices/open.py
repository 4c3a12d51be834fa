"""Opens the cameras of a rig by a device URI.

`usb:` is hardware, `mock:SCENE?seed=3&sensor=real` simulated cameras, `replay:REC` a recording in their place.
"""

from __future__ import annotations

import contextlib
import dataclasses
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast
from urllib.parse import parse_qsl, urlsplit

import libusb_package
from usb.backend import IBackend

from acquisition.devices.box_model import BoxModel, MockHid
from acquisition.devices.device_model import DeviceModel
from acquisition.devices.faults import give_fault, parse_fault
from acquisition.devices.mock import MockBackend
from acquisition.devices.replay import replay_sources
from acquisition.devices.trigger_box import TriggerBox, find_box
from acquisition.devices.usb import CameraSetupError, SoftwareTrigger, UsbCamera
from acquisition.errors import DeviceError
from acquisition.recording.reader import Recording
from acquisition.scenes.catalog import build_scene
from acquisition.scenes.misplaced import misplaced
from acquisition.scenes.scene import Scene
from acquisition.scenes.source import SceneSource
from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.sensor import SENSOR_KINDS, Sensor, SensorKind
from rigs.rig import Rig
from rigs.toml import catalog_names, catalog_rig

MOST_RIG_ERROR = 20.0


@dataclass(frozen=True)
class Simulation:
    """What simulated cameras see: a named scene, its seed, the sensor model, samples x samples rays a pixel.

    Truth is written for every `truth_every`-th plane. `fault` is a fault of one camera, as `noisy:cam12`. The cameras
    stand about `rig_error` degrees, cm and percent of the focal length away from where the rig file has them.
    """

    scene: str
    seed: int = 0
    sensor: SensorKind = "real"
    samples: int = 2
    truth_every: int = 20
    fault: str = ""
    rig_error: float = 0.0

    def __post_init__(self) -> None:
        if self.fault:
            parse_fault(self.fault)
        if self.sensor not in SENSOR_KINDS:
            raise CameraSetupError(f"found the sensor {self.sensor!r}", f"one of {', '.join(SENSOR_KINDS)}")
        if self.samples < 1 or self.truth_every < 1:
            found = f"found samples {self.samples}, truth_every {self.truth_every}"
            raise CameraSetupError(f"{found}", "at least 1 each")
        if not 0 <= self.rig_error <= MOST_RIG_ERROR:
            found = f"found the rig error {self.rig_error}"
            raise CameraSetupError(f"{found}", f"0 to {MOST_RIG_ERROR:g} degrees, cm and percent")

    def built(self, rig: Rig) -> Rig:
        """The rig as its cameras really stand, which a calibration does not move: they were built by the drawing.

        A calibrated rig without a drawing in the catalog stands as its file has it.
        """
        if not self.rig_error:
            return rig
        drawing = rig if rig.calibration is None else _drawing_of(rig)
        return rig if drawing is None else misplaced(drawing, self.rig_error, self.seed)

    def drawn(self, rig: Rig) -> Rig:
        """The rig as a recording states it: nominal where its cameras stand elsewhere and nobody has measured where."""
        return replace(rig, poses="nominal") if self.rig_error and rig.calibration is None else rig


@dataclass(frozen=True)
class OpenCameras:
    """The cameras of a rig, in its order, what starts them, and the scene before them where they are simulated."""

    cameras: tuple[UsbCamera, ...]
    trigger: SoftwareTrigger | TriggerBox
    scene: Scene | None = None


@dataclass(frozen=True)
class Replay:
    """Cameras that send again what the recording in `path` holds."""

    path: Path


Devices = Simulation | Replay | None


def parse_devices(uri: str) -> Devices:
    """None for `usb:`, what simulated cameras see for `mock:SCENE?field=value&...`, the recording of `replay:REC`.

    Raises CameraSetupError for all else.
    """
    if uri == "usb:":
        return None
    if uri.startswith("replay:") and uri != "replay:":
        return Replay(Path(uri.removeprefix("replay:")))
    parts = urlsplit(uri)
    if parts.scheme != "mock":
        raise CameraSetupError(f"found the devices {uri!r}", "usb: or mock:SCENE, or replay:REC")
    values: dict[str, object] = dict(parse_qsl(parts.query, keep_blank_values=True))
    fields = [field.name for field in dataclasses.fields(Simulation)][1:]
    for name, value in values.items():
        if name not in fields:
            raise CameraSetupError(f"found {name}", f"{', '.join(fields)}", where=uri)
        if name not in ("sensor", "fault"):
            values[name] = _number(uri, name, str(value))
    return Simulation(parts.path, **cast(dict, values))


def _drawing_of(rig: Rig) -> Rig | None:
    """The rig of the catalog that has the name and cameras of `rig`, with its sizes and serials."""
    drawing = catalog_rig(rig.name) if rig.name in catalog_names() else None
    if drawing is None or drawing.ids != rig.ids:
        return None
    pairs = zip(drawing.cameras, rig.cameras, strict=True)
    cameras = (dataclasses.replace(old.scaled(new.width, new.height), serial=new.serial) for old, new in pairs)
    return replace(drawing, cameras=tuple(cameras))


def _number(uri: str, name: str, value: str) -> int | float:
    fits = r"[0-9]+(\.[0-9]+)?" if name == "rig_error" else r"[0-9]+"
    if not re.fullmatch(fits, value):
        expected = "a number" if name == "rig_error" else "a whole number"
        raise CameraSetupError(f"found {name}={value}", f"{expected}", where=uri)
    return float(value) if name == "rig_error" else int(value)


@contextlib.contextmanager
def open_cameras(rig: Rig, devices: Devices, planes: int) -> Iterator[OpenCameras]:
    """Open all cameras of `rig`, on USB, simulated or replayed, and close them at the end.

    Simulated ones show `planes` planes. They are started by the trigger box; on USB, where none is connected, one after
    another by command.

    Raises CameraSetupError for the first camera that is missing or does not fit the rig.
    """
    if devices is None:
        with _opened(rig, _libusb()) as cameras, _closing(find_box()) as box:
            yield OpenCameras(cameras, box or SoftwareTrigger(cameras))
        return
    rig = _with_serials(rig)
    if isinstance(devices, Replay):
        scene, models = None, _replayed(rig, Recording.open(devices.path))
    else:
        scene = build_scene(devices.scene, devices.seed)
        models = _models(devices.built(rig), scene, devices, planes)
    box = TriggerBox(MockHid(BoxModel("box", models)))
    backend = MockBackend(models)
    if isinstance(devices, Simulation) and devices.fault:
        give_fault(devices.fault, dict(zip(rig.ids, models, strict=True)), backend)
    with _opened(rig, backend) as cameras, _closing(box):
        yield OpenCameras(cameras, box, scene)


def _models(rig: Rig, scene: Scene, simulation: Simulation, planes: int) -> list[DeviceModel]:
    """Simulated cameras that look at `scene` from where the rig's cameras stand."""
    threads = max(1, len(os.sched_getaffinity(0)) // len(rig.cameras))  # the cameras are read at the same time
    models = []
    for number, camera in enumerate(rig.cameras):
        size = camera.width, camera.height
        sensor = Sensor(*size, simulation.sensor, simulation.seed, number, threads=threads)
        source = SceneSource(
            scene,
            camera,
            rig.clock,
            planes,
            sensor,
            PlaneLayout(*size),
            samples=simulation.samples,
            threads=threads,
        )
        models.append(DeviceModel(camera.serial, source, rig.tick_rate_hz))
    return models


def _replayed(rig: Rig, recording: Recording) -> list[DeviceModel]:
    """Cameras that send the recording's planes again, each in the place of the rig's camera with its id."""
    sources = dict(zip(recording.camera_ids, replay_sources(recording), strict=True))
    missing = [camera_id for camera_id in rig.ids if camera_id not in sources]
    if missing:
        raise CameraSetupError(
            f"found no stream of {', '.join(missing)}", f"one for each camera of rig {rig.name}", where=recording.path
        )
    return [DeviceModel(camera.serial, sources[camera.id], recording.tick_rate_hz) for camera in rig.cameras]


@contextlib.contextmanager
def _closing(box: TriggerBox | None) -> Iterator[TriggerBox | None]:
    try:
        yield box
    finally:
        if box:
            box.close()


@contextlib.contextmanager
def _opened(rig: Rig, backend: IBackend) -> Iterator[tuple[UsbCamera, ...]]:
    with contextlib.ExitStack() as stack:
        cameras = []
        for camera in rig.cameras:
            cameras.append(UsbCamera.open(camera, rig.tick_rate_hz, backend))
            stack.callback(cameras[-1].close)
        yield tuple(cameras)


def _with_serials(rig: Rig) -> Rig:
    """A simulated camera without a serial in the rig has its id for one."""
    return dataclasses.replace(rig, cameras=tuple(dataclasses.replace(c, serial=c.serial or c.id) for c in rig.cameras))


def _libusb() -> IBackend:
    backend = libusb_package.get_libusb1_backend()
    if backend is None:
        raise DeviceError("found no libusb that loads", "the one of libusb-package", "reinstall libusb-package")
    return backend
