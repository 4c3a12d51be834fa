"""A PostgreSQL server of one's own, from the system's packages: on loopback, in a folder that is thrown away."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import tempfile
import time
from pathlib import Path

from maintenance.ports import free_port

from server.errors import ServiceError

_START_S = 60.0
_CROWD = "-c max_connections=400"  # 32 workers
_PASSWORD = "p@ss/w:rd#%? é"  # which no URL takes as it is


class PostgresqlMissingError(ServiceError):
    """PostgreSQL's programs are not installed."""


class Postgresql:
    """A server that can be killed and started again; `environment` names its one database and holds the password."""

    def __init__(self) -> None:
        found = sorted(Path("/usr/lib/postgresql").glob("*/bin/pg_ctl"))
        if not found:
            raise PostgresqlMissingError("found no /usr/lib/postgresql/*/bin", "it", "apt-get install postgresql")
        self._programs = found[-1].parent
        self.folder = Path(tempfile.mkdtemp(prefix="spike4dgs-postgresql-"))
        if os.geteuid() == 0:  # which it refuses to run as
            shutil.chown(self.folder, "postgres", "postgres")
        self.port = free_port()
        url = f"postgresql://postgres@127.0.0.1:{self.port}/spike4dgs"
        self.environment = {"SPIKE4DGS_DATABASE": url, "PGPASSWORD": _PASSWORD}
        secret = self.folder / "password"
        secret.write_text(_PASSWORD)
        asks = ("-A", "scram-sha-256", f"--pwfile={secret}")
        self._run("initdb", "-D", self._data, "-U", "postgres", *asks, "-E", "UTF8", "--no-sync")
        self.start()
        self._run("createdb", "-h", "127.0.0.1", "-p", str(self.port), "-U", "postgres", "spike4dgs")

    def start(self) -> None:
        """Start it and wait until it answers; after a kill its old processes may need a moment to go."""
        options = f"-p {self.port} -c listen_addresses=127.0.0.1 -c unix_socket_directories={self.folder} {_CROWD}"
        deadline = time.monotonic() + _START_S
        while True:
            try:
                self._run("pg_ctl", "start", "-w", "-D", self._data, "-l", str(self.folder / "log"), "-o", options)
                return
            except ServiceError:
                if time.monotonic() > deadline:
                    raise
                time.sleep(0.5)

    def kill(self) -> None:
        """kill -9 of the server."""
        os.kill(int((Path(self._data) / "postmaster.pid").read_text().split()[0]), signal.SIGKILL)

    def close(self) -> None:
        """Stop it and remove what it stored."""
        self._run("pg_ctl", "stop", "-D", self._data, "-m", "immediate")
        shutil.rmtree(self.folder)

    @property
    def _data(self) -> str:
        return str(self.folder / "data")

    def _run(self, program: str, *arguments: str) -> None:
        user = ["runuser", "-u", "postgres", "--"] if os.geteuid() == 0 else []
        command = [*user, str(self._programs / program), *arguments]
        with (self.folder / "commands").open("a+") as said:  # not a pipe, which the server would keep open
            done = subprocess.run(
                command, env=os.environ | self.environment, stdout=said, stderr=said, cwd=self.folder, check=False
            )
        if done.returncode != 0:
            raise ServiceError(f"{program}: {(self.folder / 'commands').read_text()[-300:].strip()}")
