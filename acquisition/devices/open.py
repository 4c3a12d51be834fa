"""Opens the cameras of a rig by a device URI.

`usb:` is hardware, `mock:SCENE?seed=3&sensor=real` simulated cameras, `replay:REC` a recording in their place.
"""

import contextlib
import dataclasses
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast
from urllib.parse import parse_qsl, urlsplit

import libusb_package
from usb.backend import IBackend

from acquisition.devices.box_model import BoxModel
from acquisition.devices.device_model import DeviceModel
from acquisition.devices.faults import give_fault, parse_fault
from acquisition.devices.mock import MockBackend
from acquisition.devices.profile import profiles
from acquisition.devices.trigger_box import TriggerBox, find_box
from acquisition.devices.usb import CameraSetupError, SoftwareTrigger, UsbCamera
from acquisition.errors import DeviceError
from acquisition.recording.reader import Recording
from acquisition.scenes.catalog import build_scene
from acquisition.scenes.glass import PERFECT, Glass
from acquisition.scenes.misplaced import misplaced
from acquisition.scenes.own import Own, owned
from acquisition.scenes.source import ReplaySource, SceneSource
from acquisition.scenes.view import Scenery
from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.sensor import SENSOR_KINDS, Sensor, SensorKind
from acquisition.spikes.traits import PLAIN, Traits
from rigs.rig import Rig
from rigs.toml import catalog_names, catalog_rig

MOST_RIG_ERROR = 20.0  # degrees, cm and percent
MOST_SAMPLES = 8  # rays along a side of a pixel
MOST_LIGHT = 1000.0  # factor of a scene's light
MOST_GAINS, MOST_LAGS = 0.3, 100.0  # share, ticks


@dataclass(frozen=True)
class Simulation:
    """Simulated cameras: the named scene before them, its seed, the sensor model, samples x samples rays a pixel.

    Truth is written for every `truth_every`-th plane, by default as `truth.stride_of` says. `fault` gives one camera a
    fault, as `noisy:cam12`. The cameras stand about `rig_error` degrees, cm and percent of the focal length away from
    where the rig file has them. On USB they are devices of the `profile` of that name. `light` is a factor of the
    scene's own; the sensor's dark current stays. The gains of the cameras differ by `camera_gains` (standard
    deviation); they see up to `camera_lags` ticks early or late. `traits` come on top of the sensor's. A lens of the
    `glass` is not in the rig file, which is then nominal.
    """

    scene: str
    seed: int = 0
    sensor: SensorKind = "real"
    samples: int = 2
    truth_every: int | None = None
    fault: str = ""
    rig_error: float = 0.0
    profile: str = "direct"
    light: float = 1.0
    camera_gains: float = 0.0
    camera_lags: float = 0.0
    traits: Traits = PLAIN
    glass: Glass = PERFECT

    def __post_init__(self) -> None:
        if self.fault:
            parse_fault(self.fault)
        if self.sensor not in SENSOR_KINDS:
            raise CameraSetupError(f"found the sensor {self.sensor!r}", f"one of {', '.join(SENSOR_KINDS)}")
        if self.samples < 1 or (self.truth_every is not None and self.truth_every < 1):
            raise CameraSetupError(f"found samples {self.samples}, truth_every {self.truth_every}", "at least 1 each")
        if self.samples > MOST_SAMPLES:
            raise CameraSetupError(f"found samples {self.samples}", f"at most {MOST_SAMPLES} along a side of a pixel")
        if not 0 <= self.rig_error <= MOST_RIG_ERROR:
            expected = f"0 to {MOST_RIG_ERROR:g} degrees, cm and percent"
            raise CameraSetupError(f"found the rig error {self.rig_error}", expected)
        if not 0 < self.light <= MOST_LIGHT:
            raise CameraSetupError(f"found the light {self.light}", f"a factor above 0, at most {MOST_LIGHT:g}")
        for name, most in (("camera_gains", MOST_GAINS), ("camera_lags", MOST_LAGS)):
            if not 0 <= getattr(self, name) <= most:
                raise CameraSetupError(f"found {name} {getattr(self, name)}", f"0 to {most:g}")
        if self.profile not in profiles():
            raise CameraSetupError(f"found the profile {self.profile!r}", f"one of {', '.join(profiles())}")

    def owned(self, rig: Rig) -> dict[str, Own]:
        """Return the gain and lag of each camera, by its id."""
        return dict(zip(rig.ids, owned(len(rig.ids), self.camera_gains, self.camera_lags, self.seed), strict=True))

    def sensors(self, rig: Rig, threads: int = 1) -> dict[str, Sensor]:
        """Return the sensor of each camera, by its id, as a recording begins with it."""
        own = {"threads": threads, "traits": self.traits}
        numbered = enumerate(rig.cameras)
        return {c.id: Sensor(c.width, c.height, self.sensor, self.seed, number, **own) for number, c in numbered}

    @property
    def uneven(self) -> bool:
        """A flag: cameras or pixels differ by more than those of the plain sensors."""
        return bool(self.camera_gains or self.camera_lags or self.sensor == "harsh" or self.traits != PLAIN)

    @property
    def unlike_its_file(self) -> bool:
        """A flag: cameras stand elsewhere than the rig file has them, or have other lenses."""
        return bool(self.rig_error or self.glass.lens)

    def built(self, rig: Rig) -> Rig:
        """Return the rig as its cameras really stand, which a calibration does not move.

        The file of an uncalibrated rig is the drawing that its cameras were built by, and they stand misplaced from it.
        The drawing of a calibrated rig is the catalog's; without one it stands as its file has it, lenses included.
        """
        if not self.unlike_its_file:
            return rig
        drawing = rig if rig.calibration is None else _drawing_of(rig)
        if drawing is None:
            return rig
        built = misplaced(drawing, self.rig_error, self.seed) if self.rig_error else drawing
        return self.glass.bent(built, self.seed)

    def drawn(self, rig: Rig) -> Rig:
        """Return the rig as a recording states it: nominal where its cameras are others and not calibrated."""
        return replace(rig, poses="nominal") if self.unlike_its_file and rig.calibration is None else rig


@dataclass(frozen=True)
class OpenCameras:
    """The cameras of a rig, in its order, what starts them, and the scene before them where they are simulated."""

    cameras: tuple[UsbCamera, ...]
    trigger: SoftwareTrigger | TriggerBox
    scene: Scenery | None = None


NESTED: dict[str, type[Traits | Glass]] = {"traits": Traits, "glass": Glass}  # fields of a Simulation with fields
Devices = Simulation | Path | None  # simulated cameras, a recording that is sent again, or those on USB


def parse_devices(uri: str) -> Devices:
    """Return None for `usb:`, a Simulation for `mock:SCENE?field=value&...`, the folder REC for `replay:REC`.

    Raises CameraSetupError for all else.
    """
    if uri == "usb:":
        return None
    if uri.startswith("replay:") and uri != "replay:":
        return Path(uri.removeprefix("replay:"))
    parts = urlsplit(uri)
    if parts.scheme != "mock":
        raise CameraSetupError(f"found the devices {uri!r}", "usb: or mock:SCENE, or replay:REC")
    values: dict[str, object] = dict(parse_qsl(parts.query, keep_blank_values=True))
    kinds = (Simulation, *NESTED.values())
    fields = [f.name for kind in kinds for f in dataclasses.fields(kind) if f.name not in ("scene", *NESTED)]
    for name, value in values.items():
        if name not in fields:
            raise CameraSetupError(f"found {name}", ", ".join(fields), where=uri)
        if name not in ("sensor", "fault", "profile", "lens"):
            values[name] = _number(uri, name, str(value))
    return Simulation(parts.path, **cast(dict, nested_in(values)))


def nested_in(values: dict[str, Any]) -> dict[str, Any]:
    """Return the fields of a Simulation that flat `values` by name stand for."""
    flat, nested = dict(values), {}
    for name, kind in NESTED.items():
        names = [field.name for field in dataclasses.fields(kind)]
        nested[name] = kind(**{field: flat.pop(field) for field in names if field in flat})
    return flat | nested


def _drawing_of(rig: Rig) -> Rig | None:
    """Return the rig of the catalog with the name and cameras of `rig`, in its sizes and with its serials."""
    drawing = catalog_rig(rig.name) if rig.name in catalog_names() else None
    if drawing is None or drawing.ids != rig.ids:
        return None
    pairs = zip(drawing.cameras, rig.cameras, strict=True)
    cameras = (replace(old.scaled(new.width, new.height), serial=new.serial) for old, new in pairs)
    return replace(drawing, cameras=tuple(cameras))


def _number(uri: str, name: str, value: str) -> int | float:
    kind, fits, expected = int, r"[0-9]+", "a whole number"
    if name not in ("seed", "samples", "truth_every"):
        kind, fits, expected = float, r"[0-9]+(\.[0-9]+)?", "a number"
    if not re.fullmatch(fits, value):
        raise CameraSetupError(f"found {name}={value}", expected, where=uri)
    return kind(value)


@contextlib.contextmanager
def open_cameras(rig: Rig, devices: Devices, planes: int) -> Iterator[OpenCameras]:
    """Open all cameras of `rig`, on USB, simulated or replayed, and close them at the end.

    Simulated cameras show `planes` planes. The trigger box starts the cameras; on USB, where none is connected, they
    are started one after another by command. Raises CameraSetupError for the first camera that is missing or does not
    fit the rig.
    """
    if devices is None:
        with _opened(rig, _libusb()) as cameras, contextlib.ExitStack() as stack:
            box = find_box()
            if box:
                stack.callback(box.close)
            yield OpenCameras(cameras, box or SoftwareTrigger(cameras))
        return
    rig = replace(rig, cameras=tuple(replace(c, serial=c.serial or c.id) for c in rig.cameras))
    if isinstance(devices, Path):
        scene, models = None, _replayed(rig, Recording.open(devices))
    else:
        scene = build_scene(devices.scene, devices.seed).lit(devices.light)
        models = _models(devices.built(rig), scene, devices, planes)
    box = TriggerBox(BoxModel("box", models))
    backend = MockBackend(models)
    if isinstance(devices, Simulation) and devices.fault:
        give_fault(devices.fault, dict(zip(rig.ids, models, strict=True)), backend)
    with _opened(rig, backend) as cameras, contextlib.closing(box):
        yield OpenCameras(cameras, box, scene)


def _models(rig: Rig, scene: Scenery, simulation: Simulation, planes: int) -> list[DeviceModel]:
    """Return simulated cameras that look at `scene` from where the rig's cameras stand."""
    threads = max(1, len(os.sched_getaffinity(0)) // len(rig.cameras))  # the cameras are read at the same time
    profile, own, models = profiles()[simulation.profile], simulation.owned(rig), []
    sensors = simulation.sensors(rig, threads)
    for camera in rig.cameras:
        layout = PlaneLayout(camera.width, camera.height)
        options = {"samples": simulation.samples, "threads": threads, "own": own[camera.id]}
        options |= {"pane": simulation.glass.pane(camera)}
        source = SceneSource(scene, camera, rig.clock, planes, sensors[camera.id], layout, **options)
        models.append(DeviceModel(camera.serial, source, rig.tick_rate_hz, profile=profile))
    return models


def _replayed(rig: Rig, recording: Recording) -> list[DeviceModel]:
    """Return cameras that send the recording's planes again, each in the place of the rig's camera with its id."""
    missing = [camera_id for camera_id in rig.ids if camera_id not in recording.camera_ids]
    if missing:
        found, expected = f"found no stream of {', '.join(missing)}", f"one for each camera of rig {rig.name}"
        raise CameraSetupError(found, expected, where=recording.path)
    sources = {camera_id: ReplaySource(recording.stream(camera_id)) for camera_id in recording.camera_ids}
    return [DeviceModel(camera.serial, sources[camera.id], recording.tick_rate_hz) for camera in rig.cameras]


@contextlib.contextmanager
def _opened(rig: Rig, backend: IBackend) -> Iterator[tuple[UsbCamera, ...]]:
    with contextlib.ExitStack() as stack:
        cameras = []
        for camera in rig.cameras:
            cameras.append(UsbCamera.open(camera, rig.tick_rate_hz, backend))
            stack.callback(cameras[-1].close)
        yield tuple(cameras)


def _libusb() -> IBackend:
    backend = libusb_package.get_libusb1_backend()
    if backend is None:
        raise DeviceError("found no libusb that loads", "the one of libusb-package", "reinstall libusb-package")
    return backend
