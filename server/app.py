"""The web application: REST under /v1 and the pages. It queues work and does none itself."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from importlib.metadata import version

from fastapi import FastAPI

from server.middleware import document, problems
from server.middleware.gate import Gate
from server.middleware.guard import LoopbackGuard
from server.middleware.headers import SecurityHeaders
from server.middleware.limits import BodyLimit
from server.middleware.measured import Measured
from server.routes import calibrations, captures, events, jobs, page, rigs, system, uploads, webhooks
from server.routes.parameters import KNOWN_QUERY
from server.services.services import Services
from server.settings import ServiceSettings
from server.telemetry import trace_requests
from server.work.keeper import Keeper


def create_app(settings: ServiceSettings, keeper: Keeper | None = None) -> FastAPI:
    """Return the application over a data folder; `keeper` runs its worker, if it has one of its own.

    Raises RigError for a rig that cannot be loaded, and DatabaseError.
    """
    services = Services(settings, keeper)

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        services.start()
        yield
        services.close()

    # The framework's interactive pages load scripts from elsewhere, so only /openapi.json is offered.
    app = FastAPI(
        title="spike4dgs",
        version=version("spike4dgs"),
        docs_url=None,
        redoc_url=None,
        lifespan=lifespan,
        generate_unique_id_function=lambda route: route.name,
    )
    app.state.services = services
    for module in (system, rigs, calibrations, uploads, captures, jobs, events, webhooks):
        app.include_router(module.router, prefix="/v1", dependencies=[KNOWN_QUERY])
    app.include_router(system.metrics_router, dependencies=[KNOWN_QUERY])
    app.include_router(page.router)
    app.webhooks.post("entry-changed")(webhooks.tell_entry_changed)
    problems.install(app, services.store.folder.hidden)
    document.describe(app)
    app.add_middleware(BodyLimit, settings=settings)  # the last added meets a request first
    app.add_middleware(Gate, access=services.access, settings=settings)
    app.add_middleware(LoopbackGuard, hosts=settings.hosts, origins=settings.origins)
    app.add_middleware(SecurityHeaders)
    app.add_middleware(Measured, metrics=services.metrics)
    trace_requests(app, settings)
    return app
