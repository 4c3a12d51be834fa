"""Logs as JSON lines, and traces to an OpenTelemetry collector, where a flag asks for them."""

from __future__ import annotations

import logging
import sys
from typing import TYPE_CHECKING

from server.settings import ServiceSettings, SettingsError

if TYPE_CHECKING:
    from dbos import DBOSConfig
    from fastapi import FastAPI

_FIELDS = "{asctime}{levelname}{name}{message}{process}"


def configure_logs(settings: ServiceSettings) -> None:
    """Send every logger to standard error as JSON lines, requests included; text stays as the libraries have it."""
    if settings.log != "json":
        return
    from pythonjsonlogger.json import JsonFormatter

    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(JsonFormatter(_FIELDS, style="{", rename_fields={"asctime": "at", "levelname": "level"}))
    logging.basicConfig(level=logging.INFO, handlers=[handler], force=True)
    for name in ("uvicorn", "uvicorn.access", "uvicorn.error", "dbos"):
        logger = logging.getLogger(name)
        logger.handlers.clear()
        logger.propagate = True
    logging.getLogger("httpx").setLevel(logging.WARNING)


def trace_requests(app: FastAPI, settings: ServiceSettings) -> None:
    """Send a span for each request; raises SettingsError where the packages are missing."""
    if settings.otel is None:
        return
    _need_packages()
    from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter
    from opentelemetry.instrumentation.fastapi import FastAPIInstrumentor
    from opentelemetry.sdk.resources import Resource
    from opentelemetry.sdk.trace import TracerProvider
    from opentelemetry.sdk.trace.export import BatchSpanProcessor

    provider = TracerProvider(resource=Resource({"service.name": "spike4dgs"}))
    provider.add_span_processor(BatchSpanProcessor(OTLPSpanExporter(f"{settings.otel}/v1/traces")))
    FastAPIInstrumentor.instrument_app(app, tracer_provider=provider, excluded_urls="healthz,readyz,metrics")


def engine_tracing(settings: ServiceSettings) -> DBOSConfig:
    """Return the options that make the job engine send a span for each job and stage."""
    if settings.otel is None:
        return {}  # type: ignore[typeddict-item]
    _need_packages()
    return {"enable_otlp": True, "otlp_traces_endpoints": [f"{settings.otel}/v1/traces"]}  # type: ignore[typeddict-item]


def _need_packages() -> None:
    from importlib.util import find_spec

    if find_spec("opentelemetry.instrumentation") is None:
        raise SettingsError(
            "found no OpenTelemetry packages", "them for traces", "run pip install 'spike4dgs[otel]'", where="otel"
        )
