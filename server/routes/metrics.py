"""Figures for Prometheus."""

from fastapi import APIRouter
from fastapi.responses import PlainTextResponse, Response
from prometheus_client import CONTENT_TYPE_LATEST

from server.routes.parameters import TheServices

router = APIRouter(tags=["system"])


@router.get("/metrics", response_class=PlainTextResponse)
def metrics(services: TheServices) -> Response:
    """Report queues, stages, failures, drops, disk, workers, accelerators and requests in Prometheus' text format."""
    return Response(services.metrics.text(), media_type=CONTENT_TYPE_LATEST)
