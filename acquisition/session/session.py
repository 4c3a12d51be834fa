"""One armed run of a rig: arm every camera, fire the trigger, write what they send, stop them."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import FIRST_EXCEPTION, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, field

from acquisition.devices.trigger_box import TriggerBox
from acquisition.devices.usb import SoftwareTrigger, UsbCamera
from acquisition.errors import DeviceError, StoppedError
from acquisition.progress import Progress, silent
from acquisition.recording.stream_writer import StreamWriter
from acquisition.recording.writer import RecordingWriter
from acquisition.session.capture import SPARE_S, Capture, CaptureRules

_REPORT_S, _SAVE_POLL_S = 0.2, 0.005
_LAST_SAVE_S = 0.3  # seconds that an order to save may be slower than the one to stop behind it
_BUSY = 0.4  # share of the ring in use from which a pause of the disk will lose planes
_STOP_MARGIN_S = 0.05  # seconds recorded beyond the furthest camera, so that all end at the same plane


@dataclass(frozen=True, eq=False)
class Control:
    """Orders to a running session: `stop` ends it cleanly, `save` begins it after a pre-trigger.

    `cut_off` ends it cleanly, too, but as an interruption: nobody who knows what is recorded asked for its end.
    """

    stop: threading.Event = field(default_factory=threading.Event)
    save: threading.Event = field(default_factory=threading.Event)
    cut_off: threading.Event = field(default_factory=threading.Event)

    @property
    def ends(self) -> bool:
        """Return whether the session is to end, by an order or by an interruption."""
        return self.stop.is_set() or self.cut_off.is_set()


def record_session(
    cameras: Sequence[UsbCamera],
    trigger: SoftwareTrigger | TriggerBox,
    planes: int | None,
    recording: RecordingWriter,
    progress: Progress = silent,
    *,
    pre_planes: int | None = None,
    control: Control | None = None,
    waits: bool = False,
    rejoin_s: float = 0.0,
) -> list[StreamWriter]:
    """Record `planes` of every camera, None until stopped, into `recording`; the caller commits it.

    Each camera and each file has a thread. With `pre_planes`, the run begins so many planes before `control` saves it.
    A camera that fails is noted in `recording.problems`, and the others go on; where a disk fills, all end together.
    With `waits`, the cameras wait for the host, so that a full ring holds them up instead of losing planes. A camera
    that is lost is reset and looked for, for `rejoin_s` seconds, and recorded on; the run is incomplete all the same.
    Raises DeviceError naming the camera that does not arm, or the first to fail where none sent a plane.
    """
    rate_hz = recording.rig.tick_rate_hz
    rules = CaptureRules(rate_hz, waits, planes, pre_planes, rejoin_s, trigger.period_s)
    captures = [Capture(c, recording.stream(c.id, c.layout, planes), rules) for c in cameras]
    run = _Run(captures, rules, recording, control or Control())
    with ThreadPoolExecutor(len(captures)) as pool:
        try:
            recording.mark("armed", trigger.kind)
            for capture in captures:
                capture.contact.begin()
                capture.camera.ensure_ready()
            run.steer()
            tasks = [pool.submit(capture.run, run.abort) for capture in captures]
            trigger.fire()
            recording.mark("recording", trigger.kind)
            run.watch(tasks, progress)
        finally:
            run.abort.set()
            for camera in cameras:
                camera.ensure_stopped()
    run.conclude()
    for capture in captures:
        capture.writer.device = capture.contact.to_json()
        capture.tell_clock()
    return [capture.writer for capture in captures]


class _Run:
    """Decides which planes of the cameras of one session are recorded."""

    def __init__(self, captures: list[Capture], rules: CaptureRules, recording: RecordingWriter, control: Control):
        self.abort = threading.Event()
        self._captures = captures
        self._planes, self._pre_planes = rules.planes, rules.pre_planes
        self._recording = recording
        self._control = control
        self._began = self._ended = False

    def watch(self, tasks: list[Future[None]], progress: Progress) -> None:
        """Steer and report until all are done."""
        waiting = set(tasks)
        while waiting:
            done, waiting = wait(waiting, _REPORT_S if self._began else _SAVE_POLL_S, FIRST_EXCEPTION)
            for task in done:
                task.result()
            self.steer()
            progress(*self._so_far())

    def steer(self) -> None:
        """Begin and end all cameras at common planes, when it is time."""
        if not self._began and not self._ended and (self._pre_planes is None or self._is_told_to_save()):
            self._begin()
        refused = any(capture.writer.failure for capture in self._captures)
        if not self._ended and (self._control.ends or self._recording.full or refused):
            self._end()

    def _is_told_to_save(self) -> bool:
        """Return whether the session is to be kept; an order given just before that to stop may still be on its way."""
        return self._control.save.wait(_LAST_SAVE_S if self._control.stop.is_set() else 0.0)

    def conclude(self) -> None:
        """Note what went wrong; raise where nothing was recorded."""
        failures = [capture.failure for capture in self._captures if capture.failure]
        if not any(capture.writer.planes for capture in self._captures):
            before = "the first plane" if self._began else "it was told to save"
            kind = StoppedError if self._control.stop.is_set() else DeviceError
            raise failures[0] if failures else kind(f"stopped before {before}, so nothing was kept")
        problems = [text for capture in self._captures for text in capture.returned] + list(map(str, failures))
        problems += [str(c.writer.disk_error()) for c in self._captures if c.writer.failure]
        problems += [self._recording.full] if self._recording.full else []
        planes = max(capture.writer.planes for capture in self._captures)
        if self._control.ends and self._planes and planes < self._planes:
            problems.append(f"it was stopped after {planes} of {self._planes} planes")
        if self._control.cut_off.is_set():
            problems.append(f"it was cut off after {planes} planes: the program that started it ended")
        self._recording.problems += problems

    def _begin(self) -> None:
        self._began = True
        first = 0
        if self._pre_planes is not None:
            reached = self._reached()
            first = max(0, reached - self._pre_planes)
            self._recording.trigger_plane, self._recording.first_plane = reached - first, first
        for capture in self._captures:
            capture.lead = max(capture.lead, -first)  # there is nothing before its plane 0
            if self._planes is not None:
                capture.end_at(first + self._planes)
            capture.begin_at(first)

    def _reached(self) -> int:
        """Return the plane of the rig clock that all cameras have sent; one that is lost, or lags, holds none up."""
        for capture in self._captures:
            capture.follow_the_rig_clock()
        there = [c for c in self._captures if not c.failure]
        reached = [c.reached for c in there if not c.contact.away] or [c.reached for c in there] or [0]
        lag = round(SPARE_S / 2 * self._recording.rig.tick_rate_hz)
        return max(min(reached), max(reached) - lag)

    def _end(self) -> None:
        self._ended = True
        if not self._began:
            self.abort.set()
            return
        margin = round(_STOP_MARGIN_S * self._recording.rig.tick_rate_hz)
        last = max(capture.reached for capture in self._captures) + margin
        for capture in self._captures:
            capture.end_at(last)

    def _so_far(self) -> tuple[float, str]:
        health = _health(self._captures)
        if not self._began:
            seen = min(capture.position for capture in self._captures)
            return 0.0, f"waiting to be told to save, {health}, {seen} planes seen"
        written = sum(capture.writer.planes for capture in self._captures)
        each = written // len(self._captures)
        if self._planes is None:
            return 0.0, f"{each} planes, {health}"
        fraction = written / (self._planes * len(self._captures))
        return fraction, f"{each} of {self._planes} planes, {health}"


def _health(captures: Sequence[Capture]) -> str:
    """Return all cameras in a few words: how many are well, and what is wrong with each other one."""
    unwell = [f"{capture.camera.id} {trouble}" for capture in captures if (trouble := _trouble(capture))]
    return ", ".join([f"{len(captures) - len(unwell)} of {len(captures)} cameras good", *unwell])


def _trouble(capture: Capture) -> str:
    """Return what is wrong with one camera, empty where nothing is."""
    if capture.failure:
        return f"failed after {capture.position} planes"
    if capture.contact.away:
        return f"lost after {capture.position} planes, looked for"
    lost: Counter[str] = Counter()
    for gap in capture.writer.gaps:
        lost[gap.layer] += gap.planes
    errors, ring = capture.contact.link.errors, capture.writer.ring.fullness
    if not lost and not errors and ring < _BUSY:
        return ""
    told = [f"{planes} lost ({layer})" for layer, planes in lost.items()]
    return ", ".join([*told, *([f"{errors} link errors"] if errors else []), f"ring {ring:.0%} full"])
