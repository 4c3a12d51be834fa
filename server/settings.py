"""Settings of the service: flags first, then environment variables that begin with SPIKE4DGS_."""

import ipaddress
import json
import re
import sys
import tempfile
from pathlib import Path
from typing import Annotated, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    Field,
    ValidationError,
    field_validator,
    model_validator,
)
from pydantic_settings import BaseSettings, NoDecode, SettingsConfigDict

from rigs.errors import Spike4dgsError
from rigs.rig import Rig
from rigs.toml import catalog_rig, load_rig

STAGE_COMMAND = (sys.executable, "-P", "-m", "server.cli")
_HOST = re.compile(r"([a-z0-9]([a-z0-9.-]{0,251}[a-z0-9])?|\[[0-9a-f:.]{2,45}\])(:\d{1,5})?")

_RIG = re.compile(r"[^/\x00-\x20\x7f.][^/\x00-\x1f\x7f]{0,63}")  # its name is part of addresses, and a folder's


class SettingsError(Spike4dgsError):
    """A flag or environment variable the service cannot run with."""

    exit_code = 2


def _address(host: str) -> str:
    if host == "localhost":
        return "127.0.0.1"
    try:
        return str(ipaddress.ip_address(host))
    except ValueError as error:
        raise ValueError(f"found {host[:60]}, expected an address such as 127.0.0.1 or 0.0.0.0") from error


def _listed(names: object) -> object:
    listed = tuple(name.strip() for name in names.split(",") if name.strip()) if isinstance(names, str) else names
    return tuple(str(name).lower() for name in listed) if isinstance(listed, tuple | list) else listed


def _decoded(text: object) -> object:
    try:
        return json.loads(text) if isinstance(text, str) else text
    except ValueError as error:
        raise ValueError(f"found {str(text)[:60]}, expected JSON") from error


def _host_name(host: str) -> str:
    if not _HOST.fullmatch(host):
        raise ValueError(f"found {host[:60]}, expected the name of a host, with or without :PORT")
    return host


def _rig_id(name: str) -> str:
    if not _RIG.fullmatch(name):
        expected = "at most 64 characters without a slash, the first one neither a dot nor a space"
        raise ValueError(f"found the rig's name {name[:80]!r}, expected {expected}")
    return name


def _origin(origin: str) -> str:
    scheme, _, host = origin.partition("://")
    if scheme not in ("http", "https") or not _HOST.fullmatch(host):
        raise ValueError(f"found {origin[:60]}, expected one such as https://lab.example")
    return origin


def _collector(address: str) -> str:
    if not address.startswith(("http://", "https://")):
        raise ValueError(f"found {address}, expected a collector's address such as http://127.0.0.1:4318")
    return address.rstrip("/")


def _folder(path: object) -> object:
    if path == "":  # which would be the current one
        raise ValueError("found no name, expected that of a folder")
    return path


def _postgresql(url: str) -> str:
    if not url.startswith("postgresql://"):
        raise ValueError("found another scheme, expected postgresql://USER@HOST/NAME or nothing for SQLite")
    return url


_LISTED = (NoDecode, BeforeValidator(_listed))  # in the environment: names with commas between them
_DECODED = (NoDecode, BeforeValidator(_decoded))  # in the environment: JSON


class RigSource(BaseModel):
    """A rig of the service: `rig` is a name in the catalogue or a RIG.toml, `devices` the URI of its cameras."""

    rig: str
    devices: str

    @field_validator("rig")
    @classmethod
    def _absolute(cls, rig: str) -> str:
        return str(Path(rig).absolute()) if rig.endswith(".toml") else rig

    def load(self) -> Rig:
        """Return the rig itself; raises RigError where it is not in the catalogue or its file cannot be used."""
        return load_rig(Path(self.rig)) if self.rig.endswith(".toml") else catalog_rig(self.rig)


class ServiceSettings(BaseSettings):
    """The settings of the web process and the worker: the data folder, the rigs, and how a stage is run.

    `database` is a PostgreSQL URL; without one two SQLite files lie in the data folder.
    An upload is at most `max_upload_bytes` long and leaves `keep_free_bytes` of the disk.
    `hosts` are the Host headers let in beside loopback names, with a port or for any; `origins` the pages let in beside
    the service's own, such as https://lab.example before a proxy. The body of a request has at most `body_bytes` and
    `body_s` seconds; a client may send `read_burst` reads at once and `read_rate` a second, and writes alike.
    Webhooks reach public addresses only, but any address of a host that `webhook_hosts` names. Jobs that ended more
    than `keep_days` ago are deleted, uploads that nothing at work uses after `keep_upload_days`.
    `stage_command` is put before the arguments of every stage; a stage told to stop has `grace_s` seconds to do so.
    systemd and Compose kill a service that has not ended after 30 s, so `grace_s` is well below.
    A worker that has not beaten for `dead_s` seconds is taken for dead.
    """

    model_config = SettingsConfigDict(env_prefix="SPIKE4DGS_", frozen=True)

    data: Annotated[Path, BeforeValidator(_folder), AfterValidator(Path.absolute)] = Path(".spike4dgs")
    database: Annotated[str, AfterValidator(_postgresql)] | None = None
    host: Annotated[str, AfterValidator(_address)] = "127.0.0.1"
    port: int = Field(default=8000, ge=0, le=65535)
    hosts: Annotated[tuple[Annotated[str, AfterValidator(_host_name)], ...], *_LISTED] = ()
    origins: Annotated[tuple[Annotated[str, AfterValidator(_origin)], ...], *_LISTED] = ()
    body_bytes: int = Field(default=2**20, ge=1)
    body_s: float = Field(default=30.0, gt=0)
    read_rate: float = Field(default=100.0, gt=0)
    read_burst: int = Field(default=400, ge=1)
    write_rate: float = Field(default=10.0, gt=0)
    write_burst: int = Field(default=100, ge=1)
    rigs: Annotated[dict[Annotated[str, AfterValidator(_rig_id)], RigSource], *_DECODED] = {
        "lab3x3": RigSource(rig="lab3x3", devices="usb:")
    }
    stage_command: Annotated[tuple[str, ...], *_DECODED] = STAGE_COMMAND
    grace_s: float = 20.0
    max_upload_bytes: int = 64 * 2**30
    keep_free_bytes: int = 256_000_000
    dead_s: float = Field(15.0, ge=1.0)
    gpu: int | None = None
    log: Literal["text", "json"] = "text"
    otel: Annotated[str, AfterValidator(_collector)] | None = None
    webhook_hosts: Annotated[tuple[Annotated[str, AfterValidator(_host_name)], ...], *_LISTED] = ()
    keep_upload_days: float = Field(default=7.0, gt=0, le=36_500, allow_inf_nan=False)
    keep_days: Annotated[float | None, Field(gt=0, le=36_500, allow_inf_nan=False)] = None
    locks: Path = Path(tempfile.gettempdir()) / "spike4dgs-locks"

    @model_validator(mode="before")
    @classmethod
    def _without_empty(cls, given: dict[str, object]) -> dict[str, object]:
        """Leave out what would be JSON and is empty: Compose hands a variable on that is set to nothing."""
        return {name: value for name, value in given.items() if value != "" or name not in ("rigs", "stage_command")}

    @property
    def exposed(self) -> bool:
        """Return whether others than this machine's own users may reach the service, which then needs a token."""
        return bool(self.hosts) or not ipaddress.ip_address(self.host).is_loopback

    @property
    def own_rigs(self) -> dict[str, RigSource]:
        """Return the rigs that this process was given; a worker that was given none asks the service's catalogue."""
        return self.rigs if "rigs" in self.model_fields_set else {}

    @property
    def engine_url(self) -> str:
        """Return where the job engine keeps its tables."""
        return self.database or f"sqlite:///{self.data / 'dbos.sqlite'}"

    @property
    def catalogue_url(self) -> str:
        """Return where the service keeps its own."""
        if self.database is None:
            return f"sqlite:///{self.data / 'catalogue.sqlite'}"
        return self.database.replace("postgresql://", "postgresql+psycopg://", 1)

    @property
    def database_name(self) -> str:
        """Return the database as a message may name it: without a password."""
        return str(self.data) if self.database is None else self.database.rsplit("@", 1)[-1]


def settings_of(*, rig: str | None, devices: str | None, **flags: object) -> ServiceSettings:
    """Return settings from flags (None means not given) over the environment; raises SettingsError.

    `rig` and `devices` describe one rig, which is then the only one.
    """
    given = {name: value for name, value in flags.items() if value is not None}
    try:
        settings = ServiceSettings(**given)  # pyright: ignore[reportArgumentType]
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        names = [str(part) for part in first["loc"]]
        fault = str(first.get("ctx", {}).get("error", first["msg"]))
        raise SettingsError(
            fault, do=f"mend the flag or SPIKE4DGS_{names[0].upper()}", where=".".join(names)
        ) from error
    if rig is None and devices is None:
        return settings
    source = RigSource(rig=rig or "lab3x3", devices=devices or "usb:")
    name = source.load().name
    try:
        return settings.model_copy(update={"rigs": {_rig_id(name): source}})
    except ValueError as error:
        raise SettingsError(str(error), do="give it another", where=source.rig) from error
