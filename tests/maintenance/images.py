"""Builds the images of docker/Dockerfile and asks each for its command, or says which could not be built and why."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import click

from server.errors import ServiceError

ROOT = Path(__file__).parents[2]
DOCKERFILE = ROOT / "docker" / "Dockerfile"
ENGINES = ("docker", "podman", "buildah")
IMAGES = {"server": "serve", "capture": "worker", "worker": "worker", "appliance": "serve"}  # the command of each
LEARNS, SHOWS = ("worker", "appliance"), ("server", "appliance")  # images with torch, and with the viewer
_TOLD = re.compile(r"(PIP_|NODE_EXTRA|npm_config_|https?_proxy|SSL_)")
_CERTIFICATES = "/etc/ssl/certs/ca-certificates.crt"
_KEPT_CERTIFICATES = "/etc/ssl/machine.crt"  # packages write over the other
# Run in the finished image: it records, and reconstructs where it has torch; no compilers, no sources.
_ASKED = """FROM spike4dgs-{name}
RUN spike4dgs {command} --help
RUN spike4dgs record --rig ci3x3 --devices "mock:fan_and_ball?samples=1" --ticks 60 --out /tmp/rec
RUN {torch} || exit 0; spike4dgs reconstruct /tmp/rec --out /tmp/run --holdout cam11 --steps 4
RUN test "$(id -un)" = spike4dgs && id -nG | grep -qw plugdev
RUN ! command -v g++ && ! command -v cc && ! command -v make && ! command -v npm && ! test -e /opt/spike4dgs/tests
RUN test "$(python -c 'import importlib.util as u; print(str(u.find_spec("torch") is not None).lower())')" = {torch}
RUN test {viewer} "$(python -c 'import server.page as p; print(p.__path__[0])')/viewer/vendor/spark.js"
"""


def engine() -> str:
    """Return the first engine of this machine that answers; raises ServiceError where there is none."""
    silent = []
    for name in filter(shutil.which, ENGINES):
        if subprocess.run([name, "version"], capture_output=True).returncode == 0:
            return name
        silent.append(f"{name} that does not answer")
    found = ", ".join(silent) or f"none of {', '.join(ENGINES)}"
    raise ServiceError(f"found {found}; nothing was built", "an engine for images", "apt-get install buildah")


def run(*command: str | Path) -> str:
    """Return what a command printed; raises ServiceError with its last lines where it failed."""
    done = subprocess.run(list(map(str, command)), stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    if done.returncode != 0:
        raise ServiceError(f"{command[0]} {command[1]}: exit {done.returncode}\n{done.stdout[-3000:]}")
    return done.stdout


def build(tool: str, tag: str, file: Path, *options: str) -> None:
    """Build an image of the repository's files."""
    run(tool, "build", *options, "-f", file, "-t", tag, ROOT)


def lent() -> list[str]:
    """Return options that lend the folders which this machine's pip takes packages from."""
    told = run(sys.executable, "-m", "pip", "config", "list")
    folders = {Path("/", *Path(path).parts[1:3]) for path in re.findall(r"(?:file://|[ '])(/[^\s']+)", told)}
    found = [path for path in sorted(folders) if path.is_dir() and path.parts[1] not in ("etc", "usr")]
    return [f"--volume={path}:{path}:ro" for path in found]


def make_base(tag: str) -> None:
    """Make the Debian image that the Dockerfile begins with, with this machine's settings, out of Debian's packages.

    Raises ServiceError without Buildah and debootstrap.
    """
    if engine() != "buildah" or not shutil.which("debootstrap"):
        raise ServiceError("found no debootstrap, or another engine before buildah", "both for --local-base")
    release = tag.partition(":")[2].removesuffix("-slim")
    with tempfile.TemporaryDirectory(prefix="spike4dgs-images-") as folder:
        root = Path(folder) / "root"
        run("debootstrap", "--variant=minbase", release, root)
        (root / "etc/ssl").mkdir(exist_ok=True)
        for path, place in (("/etc/apt", "/etc/apt"), (_CERTIFICATES, _KEPT_CERTIFICATES)):
            run("cp", "-aLT", path, root / place[1:])
        pip = run(sys.executable, "-m", "pip", "config", "list")
        lines = dict(re.findall(r"^global\.([\w-]+)='(.*)'$", pip, re.MULTILINE))
        text = "\n".join(f"{name} = {value}" for name, value in lines.items())
        (root / "etc/pip.conf").write_text(f"[global]\n{text}\n")
        container = run("buildah", "from", "scratch").strip()
        try:
            run("buildah", "add", container, root, "/")
            told = {name: value for name, value in os.environ.items() if _TOLD.match(name)}
            settings = [
                f"--env={name}={value}".replace(_CERTIFICATES, _KEPT_CERTIFICATES) for name, value in told.items()
            ]
            run("buildah", "config", *settings, container)
            run("buildah", "commit", container, f"docker.io/library/{tag}")
        finally:
            run("buildah", "rm", container)


def check(tool: str, name: str) -> None:
    """Ask a finished image for what it must have and must lack; raises ServiceError."""
    torch, viewer = str(name in LEARNS).lower(), "-s" if name in SHOWS else "! -e"
    with tempfile.NamedTemporaryFile("w", suffix=".Dockerfile") as file:
        file.write(_ASKED.format(name=name, command=IMAGES[name], torch=torch, viewer=viewer))
        file.flush()
        build(tool, "spike4dgs-asked", Path(file.name))
    run(tool, "rmi", "spike4dgs-asked")


@click.command()
@click.option("--local-base", is_flag=True, help="Make Debian's image by debootstrap, with this machine's settings.")
@click.option("--only", "names", type=click.Choice(list(IMAGES)), multiple=True, default=list(IMAGES))
def main(local_base: bool, names: tuple[str, ...]) -> None:
    """Build the images one after the other; the exit status is 1 where one could not be built."""
    tool = engine()
    options = []
    if tool == "buildah":  # which runs in a container, too, and without a daemon
        for variable, value in (("BUILDAH_ISOLATION", "chroot"), ("STORAGE_DRIVER", "vfs")):
            os.environ.setdefault(variable, value)
    if local_base:
        base = re.search(r"^FROM (debian:\S+)", DOCKERFILE.read_text(), re.MULTILINE)
        assert base is not None
        click.echo(f"makes {base[1]}")
        make_base(base[1])
        options = ["--pull-never", *lent()]
    failed = []
    for name in names:
        click.echo(f"builds spike4dgs-{name} with {tool}")
        try:
            build(tool, f"spike4dgs-{name}", DOCKERFILE, "--target", name, *options)
            check(tool, name)
        except ServiceError as error:
            failed.append(name)
            click.echo(f"spike4dgs-{name} was not built: {error}", err=True)
        else:
            size = run(tool, "images", "--format", "{{.Size}}", f"spike4dgs-{name}").split("\n")[0]
            click.echo(f"built spike4dgs-{name}, {size}")
    sys.exit(bool(failed))


if __name__ == "__main__":
    try:
        main()
    except ServiceError as error:
        sys.exit(str(error))
