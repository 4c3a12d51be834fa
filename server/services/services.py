"""All services of one web process."""

from rigs.rig import Rig
from rigs.toml import dump_rig
from server.engine import Engine
from server.services.access import AccessService
from server.services.admission import Admission
from server.services.announcer import Announcer
from server.services.artefacts import ArtefactService
from server.services.calibrations import CalibrationService
from server.services.captures import CaptureService, RigService
from server.services.health import HealthService
from server.services.hub import Hub
from server.services.imports import ImportService
from server.services.inspections import InspectionService
from server.services.jobs import JobService
from server.services.looks import LookService
from server.services.metrics import Metrics
from server.services.pictures import PictureService
from server.services.previews import PreviewService
from server.services.queue import Queue
from server.services.retention import Retention
from server.services.rig_jobs import RigJobService
from server.services.space import Space
from server.services.uploads import UploadService
from server.services.watchdog import Watchdog
from server.services.webhooks import WebhookService
from server.settings import ServiceSettings
from server.store.store import Store
from server.store.tables import KnownRig
from server.work.keeper import Keeper


class Services:
    """Built once from the settings. Raises RigError for a rig that cannot be loaded, and DatabaseError."""

    def __init__(self, settings: ServiceSettings, keeper: Keeper | None = None) -> None:
        rigs = {rig_id: source.load() for rig_id, source in settings.rigs.items()}  # before anything is written
        self.settings = settings
        self.store = Store(settings)
        self.engine = Engine(settings)
        self.store.disk.keep_reserve()
        self._tell_rigs(rigs)
        self.queue = queue = Queue(self.store, self.engine)
        space = Space(self.store, rigs)
        self.rigs = RigService(self.store, self.engine, queue, space, settings.rigs)
        self.captures = CaptureService(self.store, self.engine, queue)
        self.jobs = JobService(self.store, self.engine, queue, Admission(self.store, self.engine, self.rigs))
        self.calibrations = CalibrationService(self.store, queue, self.rigs, self.jobs)
        self.artefacts = ArtefactService(self.store, self.engine)
        self.health = HealthService(settings, self.store, self.engine, keeper)
        self.keeper = keeper
        self.watchdog = Watchdog(keeper)
        self.uploads = UploadService(self.store, queue, space, settings.max_upload_bytes, settings.keep_free_bytes)
        self.inspections = InspectionService(self.uploads, self.rigs)
        self.imports = ImportService(self.store, queue, self.uploads, self.rigs, space)
        self.previews = PreviewService(self.store, self.engine)
        self.pictures = PictureService(self.store, self.engine, self.artefacts, self.previews)
        self.looks = LookService(self.store, self.rigs)
        self.rig_jobs = RigJobService(self.store, self.engine, queue, self.rigs, self.jobs, self.looks)
        self.access = AccessService(self.store.tokens, settings)
        self.hub = Hub(self.store)
        self.webhooks = WebhookService(self.store, settings.webhook_hosts)
        self.metrics = Metrics(settings, self.store, self.engine)
        retention = Retention(
            self.store, self.engine, self.jobs, self.uploads, settings.keep_days, settings.keep_upload_days
        )
        self.announcer = Announcer(self.store, self.engine, queue, retention)

    def _tell_rigs(self, rigs: dict[str, Rig]) -> None:
        """Note the rigs where workers of all machines read them, with their pixel maps in the shared folder."""
        documents = {rig_id: dump_rig(self.store.rig_files.adopt_pixels(rig_id, rig)) for rig_id, rig in rigs.items()}
        sources = self.settings.rigs
        self.store.known_rigs.replace([KnownRig(i, text, sources[i].devices) for i, text in documents.items()])

    def start(self) -> None:
        """Start the work beside the requests; call it in the event loop."""
        self.hub.start()
        self.announcer.thread.start()
        self.webhooks.thread.start()
        self.watchdog.start()

    def begin_close(self) -> None:
        """Let the worker of this process end while requests under way are waited for, and end every stream."""
        if self.keeper is not None:
            self.keeper.stop()
        self.hub.close()

    def close(self) -> None:
        """End that work, and let go of the databases."""
        self.watchdog.close()
        self.hub.close()
        self.announcer.thread.stop()
        self.webhooks.thread.stop()
        self.queue.close()
        self.engine.close()
        self.store.close()
