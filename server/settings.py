"""Settings of the service: flags first, then environment variables that begin with SPIKE4DGS_."""

from __future__ import annotations

import ipaddress
import sys
import tempfile
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, Field, ValidationError, field_validator
from pydantic_settings import BaseSettings, SettingsConfigDict

from rigs.errors import Spike4dgsError
from rigs.rig import Rig
from rigs.toml import catalog_rig, load_rig


class SettingsError(Spike4dgsError):
    """A flag or environment variable the service cannot run with."""

    exit_code = 2


class RigSource(BaseModel):
    """Where a rig is described (a name in the catalogue or a RIG.toml) and where its cameras are (a device URI)."""

    rig: str
    devices: str

    @field_validator("rig")
    @classmethod
    def _absolute(cls, rig: str) -> str:
        return str(Path(rig).absolute()) if rig.endswith(".toml") else rig

    def load(self) -> Rig:
        """The rig itself; raises RigError where it is not in the catalogue or its file cannot be used."""
        return load_rig(Path(self.rig)) if self.rig.endswith(".toml") else catalog_rig(self.rig)


class ServiceSettings(BaseSettings):
    """What the web process and the worker share: the data folder, the rigs, and how a stage is run.

    `database` is a PostgreSQL URL; without one two SQLite files lie in the data folder.
    Webhooks reach public addresses only, but any address of a host that `webhook_hosts` names. Jobs that ended more
    than `keep_days` ago are deleted.
    `stage_command` is put before the arguments of every stage; a stage told to stop has `grace_s` seconds to do so.
    """

    model_config = SettingsConfigDict(env_prefix="SPIKE4DGS_", frozen=True)

    data: Path = Path(".spike4dgs")
    database: str | None = None
    host: str = "127.0.0.1"
    port: int = 8000
    rigs: dict[str, RigSource] = {"lab3x3": RigSource(rig="lab3x3", devices="usb:")}
    stage_command: tuple[str, ...] = (sys.executable, "-P", "-m", "server.cli")
    grace_s: float = 8.0
    gpu: int | None = None
    webhook_hosts: tuple[str, ...] = ()
    keep_days: Annotated[float | None, Field(gt=0, le=36_500, allow_inf_nan=False)] = None
    locks: Path = Path(tempfile.gettempdir()) / "spike4dgs-locks"

    @field_validator("data")
    @classmethod
    def _absolute(cls, data: Path) -> Path:
        return data.absolute()

    @field_validator("host")
    @classmethod
    def _loopback(cls, host: str) -> str:
        if host == "localhost":
            return "127.0.0.1"
        try:
            loopback = ipaddress.ip_address(host).is_loopback
        except ValueError:
            loopback = False
        if not loopback:
            raise ValueError(f"found {host}, expected a loopback address such as 127.0.0.1: the service has no login")
        return host

    @field_validator("database")
    @classmethod
    def _postgresql(cls, database: str | None) -> str | None:
        if database is not None and not database.startswith("postgresql://"):
            raise ValueError("found another scheme, expected postgresql://USER@HOST/NAME or nothing for SQLite")
        return database

    @property
    def engine_url(self) -> str:
        """Where the job engine keeps its tables."""
        return self.database or f"sqlite:///{self.data / 'dbos.sqlite'}"

    @property
    def catalogue_url(self) -> str:
        """Where the service keeps its own."""
        if self.database is None:
            return f"sqlite:///{self.data / 'catalogue.sqlite'}"
        return self.database.replace("postgresql://", "postgresql+psycopg://", 1)

    @property
    def database_name(self) -> str:
        """The database as a message may name it: without a password."""
        return str(self.data) if self.database is None else self.database.rsplit("@", 1)[-1]


def settings_of(*, rig: str | None, devices: str | None, **flags: object) -> ServiceSettings:
    """Settings from flags (None means not given) over the environment; raises SettingsError in one line.

    `rig` and `devices` describe one rig, which is then the only one.
    """
    given = {name: value for name, value in flags.items() if value is not None}
    try:
        settings = ServiceSettings(**given)  # pyright: ignore[reportArgumentType]
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(str(part) for part in first["loc"])
        fault = first["msg"].removeprefix("Value error, ")
        raise SettingsError(f"{where}: {fault}; mend the flag or SPIKE4DGS_{where.upper()}") from error
    if rig is None and devices is None:
        return settings
    source = RigSource(rig=rig or "lab3x3", devices=devices or "usb:")
    return settings.model_copy(update={"rigs": {source.load().name: source}})
