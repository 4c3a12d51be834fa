"""Figures for Prometheus: counted from what has ended, and looked up when they are asked for."""

import shutil
import threading
from collections.abc import Iterator, Sequence

from prometheus_client import CollectorRegistry, Counter, Histogram, generate_latest
from prometheus_client.core import GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from acquisition.errors import BadRecordingError
from acquisition.recording.reader import read_any_manifest
from server.engine import RECONSTRUCTIONS, TASKS, Engine, capture_queue
from server.schemas.progress import ACTIVE
from server.settings import ServiceSettings
from server.store.engine_tables import SPANS
from server.store.files import is_locked
from server.store.store import Store
from server.store.tables import Entry, Event

_PAGE = 500
_BUCKETS = (0.005, 0.01, 0.025, 0.05, 0.1, 0.2, 0.5, 1.0, 2.5, 10.0)


class Metrics(Collector):
    """The figures of one service.

    What has ended is counted from the table of events, whose beginning is before this process: the counters go on over
    a restart, and are the same in every web process. Requests are this process's own.
    """

    def __init__(self, settings: ServiceSettings, store: Store, engine: Engine) -> None:
        self._settings = settings
        self._store = store
        self._engine = engine
        self._seen = 0
        self._counted: dict[str, dict[str, float]] = {}  # seconds by stage of entries that may go on
        self._lock = threading.Lock()
        self.registry = CollectorRegistry()
        own = {"registry": self.registry, "namespace": "spike4dgs"}
        self._seconds = Counter("stage_seconds", "Seconds spent in a stage.", ["stage"], **own)
        self._ended = Counter("ended", "Captures and jobs that ended.", ["type", "status"], **own)
        self._failures = Counter("failures", "Captures and jobs that failed.", ["type"], **own)
        self._planes = Counter("capture_planes", "Planes recorded, lost ones too.", **own)
        self._dropped = Counter("capture_dropped_planes", "Planes lost, by where.", ["layer"], **own)
        self._requests = Counter("http_requests", "Requests.", ["method", "route", "status"], **own)
        self._latency = Histogram(
            "http_request_seconds", "Seconds to the head of the answer.", ["method", "route"], buckets=_BUCKETS, **own
        )
        self.registry.register(self)

    def text(self) -> bytes:
        """Return all figures, in Prometheus' text format."""
        self.follow()
        return generate_latest(self.registry)

    def request(self, method: str, route: str, status: int, seconds: float) -> None:
        """Count a request."""
        self._requests.labels(method, route, str(status)).inc()
        self._latency.labels(method, route).observe(seconds)

    def follow(self) -> None:
        """Count what has ended since the last time."""
        with self._lock:
            while events := self._store.events.ended(self._seen, _PAGE):
                entries = {entry.id: entry for entry in self._store.entries.find([event.entry for event in events])}
                for event in events:
                    self._seen = event.seq
                    if event.entry in entries:
                        self._count(event, entries[event.entry])

    def describe(self) -> Sequence[Metric]:
        """Return nothing: a description would need the database before anybody asks."""
        return []

    def collect(self) -> Iterator[Metric]:
        """Yield the figures of this moment."""
        yield self._queues()
        free = GaugeMetricFamily("spike4dgs_disk_free_bytes", "Bytes free under the data folder.")
        free.add_metric([], shutil.disk_usage(self._store.folder.path).free)
        yield free
        workers = GaugeMetricFamily("spike4dgs_workers", "Workers alive, by queue.", labels=["queue"])
        alive = self._store.workers.alive()
        for queue in self._names():
            workers.add_metric([queue], sum(queue in worker.queues for worker in alive))
        yield workers
        busy = GaugeMetricFamily("spike4dgs_gpu_busy", "1 while a job trains on it; on this host.", labels=["gpu"])
        for folder in sorted(self._settings.locks.glob("gpu*")):
            busy.add_metric([folder.name.removeprefix("gpu")], is_locked(folder))
        yield busy

    def _names(self) -> list[str]:
        return [*(capture_queue(rig) for rig in self._settings.rigs), RECONSTRUCTIONS, TASKS]

    def _queues(self) -> Metric:
        depth = GaugeMetricFamily("spike4dgs_queue_depth", "Captures and jobs to be done.", labels=["queue", "status"])
        found = self._engine.count()
        for queue in sorted({*self._names(), SPANS, *(name for name, _ in found)}):
            for status in ACTIVE:
                depth.add_metric([queue, status], found.get((queue, status), 0))
        return depth

    def _count(self, event: Event, entry: Entry) -> None:
        status = str(event.data["status"])
        self._ended.labels(entry.type, status).inc()
        if status == "failed":
            self._failures.labels(entry.type).inc()
        known = self._counted.get(entry.id, {})
        seconds: dict[str, float] = entry.progress.get("seconds", {})
        for stage, spent in seconds.items():
            self._seconds.labels(stage).inc(max(0.0, spent - known.get(stage, 0.0)))
        self._counted[entry.id] = seconds
        if entry.kind == "capture" and status == "done":
            self._count_planes(entry)

    def _count_planes(self, entry: Entry) -> None:
        try:
            manifest = read_any_manifest(self._store.folder.recording(entry.id))
        except BadRecordingError:  # deleted or damaged since; whoever opens it is told
            return
        for camera in manifest.cameras:
            self._planes.inc(camera.planes)
            for layer, planes in camera.drops.items():
                self._dropped.labels(layer).inc(planes)
