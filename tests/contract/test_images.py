"""Runs the Dockerfile in a clean root: `make images`. It needs root and debootstrap, no container engine.

Every image's RUN lines are executed in a chroot of the same Debian release, with the repository's files copied to where
COPY puts them; then its command is asked for its help, and the service is started and asked whether it is there.
"""

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
MISSING = [name for name in ("debootstrap", "chroot", "git") if shutil.which(name) is None]
pytestmark = [
    pytest.mark.images,
    pytest.mark.skipif(bool(MISSING) or os.geteuid() != 0, reason=f"needs root and {', '.join(MISSING) or 'nothing'}"),
]
NETWORK = ("/etc/resolv.conf", "/etc/hosts", "/etc/ssl/certs/ca-certificates.crt")
SYSTEM_PATH = "/usr/sbin:/usr/bin:/sbin:/bin"
KEPT = {name: value for name, value in os.environ.items() if re.match(r"(PIP_|npm_config_|https?_proxy|SSL_)", name)}


def pip_configuration() -> str:
    """Read pip's settings of this machine, the source of the build argument PIP_EXTRA_INDEX_URL."""
    pip = [sys.executable, "-m", "pip", "config", "list"]
    return subprocess.run(pip, capture_output=True, text=True, check=True).stdout


def local_indexes() -> list[Path]:
    """Folders that this machine's pip takes packages from, which a clean root lacks."""
    found = {
        Path("/", *Path(path).parts[1:3]) for path in re.findall(r"(?:file://|[ '])(/[^\s']+)", pip_configuration())
    }
    return [path for path in sorted(found) if path.is_dir() and path.parts[1] not in ("etc", "usr")]


def lines_of(stage: str) -> list[tuple[str, str]]:
    """Instructions of an image, those of its base first, with continued lines joined."""
    text = (ROOT / "docker" / "Dockerfile").read_text()
    joined = re.sub(r"\\\n", " ", re.sub(r"^#.*\n", "", text, flags=re.MULTILINE))
    blocks = {
        name: (base, body) for base, name, body in re.findall(r"FROM (\S+) AS (\w+)\n((?:(?!FROM).*\n?)*)", joined)
    }
    base, body = blocks[stage]
    own = [tuple(line.split(" ", 1)) for line in body.splitlines() if " " in line]
    return (lines_of(base) if base in blocks else []) + own  # type: ignore[return-value]


@pytest.fixture(scope="module")
def clean_root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    release = re.search(r"FROM debian:(\w+)-slim", (ROOT / "docker" / "Dockerfile").read_text())
    assert release is not None
    folder = tmp_path_factory.mktemp("images") / "base"
    subprocess.run(["debootstrap", "--variant=minbase", release[1], folder], check=True, stdout=subprocess.DEVNULL)
    return folder


@pytest.fixture
def image(clean_root: Path, request: pytest.FixtureRequest) -> Iterator[tuple[Path, str]]:
    root = clean_root.with_name(request.param)
    subprocess.run(["cp", "-a", clean_root, root], check=True)
    subprocess.run(["cp", "-aLT", "/etc/apt", root / "etc/apt"], check=True)
    for folder in local_indexes():
        subprocess.run(["cp", "-a", "--parents", folder, root], check=True)
    yield root, request.param
    shutil.rmtree(root)


def inside(root: Path, command: str, where: str = "/", **settings: str) -> str:
    for path in NETWORK:  # the network as this machine reaches it; packages write over some of these
        subprocess.run(["cp", "-L", "--parents", path, root], check=False, stderr=subprocess.DEVNULL)
    index = re.search(r"extra-index-url='([^']*)'", pip_configuration())
    environment = {
        "PATH": SYSTEM_PATH,
        "HOME": "/root",
        "PIP_EXTRA_INDEX_URL": index[1] if index else "",
        **KEPT,
        **settings,
    }
    done = subprocess.run(
        ["chroot", root, "sh", "-c", f"cd {where} && {command}"], env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, f"{command}\n{done.stdout[-2000:]}\n{done.stderr[-4000:]}"
    return done.stdout


@pytest.mark.parametrize("image", ["server", "capture", "worker"], indirect=True)
def test_an_image_builds_and_its_command_is_there(image: tuple[Path, str]) -> None:
    root, stage = image
    where, settings = "/", {"DEBIAN_FRONTEND": "noninteractive"}
    command: list[str] = []
    for word, rest in lines_of(stage):
        if word == "RUN":
            inside(root, rest, where, **settings)
        elif word == "WORKDIR":
            where = rest
            (root / rest[1:]).mkdir(parents=True)
        elif word == "COPY":
            files = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True).stdout
            copy = f"tar --create --null --files-from=- | tar --extract --directory={root / where[1:]}"
            subprocess.run(["sh", "-c", copy], cwd=ROOT, input=files, check=True)
        elif word == "ENV":
            name, value = rest.split("=", 1)
            settings[name] = value.replace("$PATH", SYSTEM_PATH)
        elif word == "CMD":
            command = json.loads(rest)
    name = "serve" if stage == "server" else "worker"
    assert name in " ".join(command)
    assert "Usage: spike4dgs" in inside(root, f"spike4dgs {name} --help", where, **settings)
    torch = inside(
        root, "python -c 'import importlib.util as u; print(u.find_spec(\"torch\") is not None)'", **settings
    )
    assert torch.strip() == str(stage == "worker")
