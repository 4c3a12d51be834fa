"""The web application: REST under /v1 and the pages. It queues work and never does any."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from importlib.metadata import version

from fastapi import FastAPI

from server import errors
from server.guard import LoopbackGuard
from server.measured import Measured
from server.routes import captures, events, jobs, metrics, page, rigs, system, webhooks
from server.services.services import Services
from server.settings import ServiceSettings


def create_app(settings: ServiceSettings) -> FastAPI:
    """The application over a data folder. Raises RigError for a rig that cannot be loaded, and DatabaseError."""
    services = Services(settings)

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        services.start()
        yield
        services.close()

    # The interactive pages of the framework load scripts from elsewhere; the document itself stays at /openapi.json.
    app = FastAPI(title="spike4dgs", version=version("spike4dgs"), docs_url=None, redoc_url=None, lifespan=lifespan)
    app.state.services = services
    for module in (system, rigs, captures, jobs, events, webhooks):
        app.include_router(module.router, prefix="/v1")
    app.include_router(metrics.router)
    app.include_router(page.router)
    errors.install(app)
    app.add_middleware(LoopbackGuard)
    app.add_middleware(Measured, metrics=services.metrics)
    return app
