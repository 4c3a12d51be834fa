"""Makes a whole recording: opens cameras by a URI, runs them once, and writes the truth where it is known."""

from dataclasses import dataclass, field
from pathlib import Path

from acquisition.devices.open import Devices, Simulation, open_cameras, parse_devices
from acquisition.devices.registers import Sensitivity
from acquisition.errors import BadRecordingError, IncompleteError
from acquisition.progress import Progress, part, silent
from acquisition.recording.manifest import TRUTH_FOLDER, Manifest, note_bytes
from acquisition.recording.writer import MARGIN_BYTES, DiskUse, RecordingWriter, disk_errors
from acquisition.scenes.glass import PERFECT, write_glass
from acquisition.scenes.own import write_own
from acquisition.scenes.truth import exposures_of, stride_of, write_truth
from acquisition.scenes.view import Scenery
from acquisition.session.memory import available_bytes
from acquisition.session.rig_lock import rig_lock
from acquisition.session.session import Control, record_session
from acquisition.spikes.layout import PlaneLayout
from rigs.rig import Rig

_TRUTH_BYTES, _FRAME_BYTES = 16, 4  # a pixel: light, depth, object and blur; an ordinary camera's frame
_RECORDING_SHARE, _WRITTEN = 0.8, 0.99  # shares of the work: after the planes where truth follows, before the name
_DRAWING_SHARE, _DRAWN_PLANES = 0.5, 0.05  # where a scene is drawn: its light, and the planes that follow
_RING_S, _MIN_RING_BYTES = 0.5, 4 << 20  # the pause of a disk, in seconds, that a ring bridges, and its least size
_ENDLESS = 1 << 62


@dataclass(frozen=True)
class Take:
    """The length of a recording, how the cameras are set, and what to leave of the disk.

    Records `planes` of every camera, None until `control` stops it. `pre_trigger_ms` keeps the last milliseconds until
    `control` saves; they count among `planes`. The run ends before less than `keep_free_bytes` are free. The cameras
    are set to `sensitivity`; None leaves them as they are. A hardware camera that is lost is looked for, for `rejoin_s`
    seconds.
    """

    planes: int | None
    pre_trigger_ms: float | None = None
    keep_free_bytes: int = MARGIN_BYTES
    control: Control = field(default_factory=Control)
    sensitivity: Sensitivity | None = None
    rejoin_s: float = 0.0

    def __post_init__(self) -> None:
        if self.planes is not None and self.planes < 1:
            raise BadRecordingError(f"found {self.planes} ticks", "at least 1")
        if self.pre_trigger_ms is not None and not 0 < self.pre_trigger_ms < float("inf"):
            raise BadRecordingError(f"found a pre-trigger of {self.pre_trigger_ms} ms", "more than 0")

    def pre_planes(self, tick_rate_hz: float) -> int | None:
        """Return the planes before the trigger, None without one; raises BadRecordingError where no more are wanted."""
        planes = None if self.pre_trigger_ms is None else round(self.pre_trigger_ms * 1e-3 * tick_rate_hz)
        if planes is not None and self.planes is not None and self.planes <= planes:
            found = f"found {self.planes} ticks with the {planes} before the trigger"
            raise BadRecordingError(found, "more", "record for longer, or shorten --pre-trigger")
        return planes


def record(rig: Rig, devices: str, take: Take | int, out: Path, progress: Progress = silent) -> Manifest:
    """Record every camera of `rig`, opened by the URI `devices`, as the folder `out`; `take` may be a number of planes.

    Raises RigBusyError where somebody else records with the rig, DeviceError where a camera does not arm, DiskError
    for a full disk: then nothing is left under `out`. Raises IncompleteError naming the camera that failed on the way,
    or the disk that filled: `out` then holds what was recorded, marked incomplete.
    """
    take = Take(take) if isinstance(take, int) else take
    opened = parse_devices(devices)
    with rig_lock(rig.name, out):
        return _record(rig, opened, take, out, progress)


def simulate(simulation: Simulation, rig: Rig, ticks: int, out: Path, progress: Progress = silent) -> Manifest:
    """Record simulated cameras, which nobody else can be using; otherwise as `record`."""
    return _record(rig, simulation, Take(ticks), out, progress)


def _record(rig: Rig, devices: Devices, take: Take, out: Path, progress: Progress) -> Manifest:
    pre_planes = take.pre_planes(rig.tick_rate_hz)
    _check_memory(rig, pre_planes or 0)
    share = _RECORDING_SHARE if isinstance(devices, Simulation) else _WRITTEN
    drawn = devices.drawn(rig) if isinstance(devices, Simulation) else rig
    with RecordingWriter(out, drawn, _disk_use(rig, devices, take)) as recording:
        with open_cameras(rig, devices, take.planes if pre_planes is None and take.planes else _ENDLESS) as opened:
            begun = 0.0
            if isinstance(devices, Simulation) and opened.scene and take.planes:
                begun = _draw_light(opened.scene, devices.built(rig), take.planes, progress)
                share = begun + _DRAWN_PLANES if begun else share
            for camera in opened.cameras if take.sensitivity else ():
                camera.registers.set_sensitivity(take.sensitivity or Sensitivity())
            streams = record_session(
                opened.cameras,
                opened.trigger,
                take.planes,
                recording,
                part(progress, begun, share),
                pre_planes=pre_planes,
                control=take.control,
                waits=devices is not None,
                rejoin_s=take.rejoin_s if devices is None else 0.0,
            )
        nominal = take.sensitivity is None or take.sensitivity.gain == 1  # truth is in spikes of a nominal camera
        if isinstance(devices, Simulation) and opened.scene and nominal:
            scene = opened.scene.since(recording.first_plane / rig.tick_rate_hz)
            planes, folder = max(s.planes for s in streams), recording.folder / TRUTH_FOLDER
            every = devices.truth_every or stride_of(planes)
            with disk_errors(folder):
                report = part(progress, share, _WRITTEN)
                write_truth(scene, devices.built(rig), planes, every, folder, report, sensor=devices.sensor)
                if devices.uneven:
                    write_own(folder, devices.owned(rig), devices.sensors(rig))
                if devices.glass != PERFECT:
                    write_glass(folder, devices.glass, devices.built(rig).cameras)
        manifest = recording.commit(recording.entries(), opened.trigger.kind)
    progress(1.0, f"{len(streams)} cameras, {max(stream.planes for stream in streams)} planes each")
    if manifest.reason:
        raise IncompleteError(manifest.reason, do=f"{out} keeps what was recorded, marked incomplete")
    return manifest


def _draw_light(scene: Scenery, rig: Rig, planes: int, progress: Progress) -> float:
    """Draw what `scene` lacks, and return the share of the work that is done: 0 where it lacks nothing."""
    done = 0.0

    def told(fraction: float, message: str) -> None:
        nonlocal done
        done = _DRAWING_SHARE * fraction
        progress(done, message)

    scene.prepare(rig.cameras, rig.clock.instant_s(planes), told)
    return done


def _check_memory(rig: Rig, pre_planes: int) -> None:
    """Raise BadRecordingError where the planes before the trigger do not fit half of the memory that can be had."""
    needed = pre_planes * sum(PlaneLayout(camera.width, camera.height).plane_bytes for camera in rig.cameras)
    free = available_bytes()
    if needed > free // 2:
        raise BadRecordingError(
            f"found a pre-trigger of {needed} bytes", f"at most half of the {free} bytes of memory", "shorten it"
        )


def _disk_use(rig: Rig, devices: Devices, take: Take) -> DiskUse:
    plane_bytes = [PlaneLayout(camera.width, camera.height).plane_bytes for camera in rig.cameras]
    planes = take.planes or 0
    truth = 0
    if isinstance(devices, Simulation):
        instants = -(-planes // (devices.truth_every or stride_of(planes)))
        a_pixel = instants * _TRUTH_BYTES + len(exposures_of(rig.tick_rate_hz, planes, instants)) * _FRAME_BYTES
        truth = a_pixel * sum(camera.width * camera.height for camera in rig.cameras)
    ring = max(_MIN_RING_BYTES, round(_RING_S * rig.tick_rate_hz * max(plane_bytes)))
    notes = sum(note_bytes(planes, PlaneLayout(camera.width, camera.height)) for camera in rig.cameras)
    return DiskUse(planes * sum(plane_bytes) + notes + truth, take.keep_free_bytes, ring, devices is not None)
