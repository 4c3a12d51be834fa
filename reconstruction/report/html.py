"""Fills the report that an operator reads: one self-contained HTML file."""

import base64
from collections.abc import Mapping
from importlib import resources

import jinja2


def embed(data: bytes, media_type: str = "image/png") -> str:
    """Return a picture or video as a data address, so that the page stands alone."""
    return f"data:{media_type};base64,{base64.b64encode(data).decode()}"


def report_html(document: Mapping[str, object]) -> str:
    """Return the page; `document` is what `pipeline.report_stage` gathers."""
    template = resources.files("reconstruction.report").joinpath("report.html.j2").read_text()
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True)
    return environment.from_string(template).render(document)
