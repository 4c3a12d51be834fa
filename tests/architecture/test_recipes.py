"""The recipes of CONTRIBUTING.md, each carried out on a copy of the tree: no file changes but those it names."""

import shutil
import subprocess
import sys
from pathlib import Path
from textwrap import dedent

import pytest

ROOT = Path(__file__).resolve().parents[2]
pytestmark = pytest.mark.slow
# The copy comes before the installed package, whose native libraries it uses.
IN_COPY = """
import sys
sys.meta_path[:] = [finder for finder in sys.meta_path if "ScikitBuild" not in type(finder).__name__]
sys.path.insert(0, {copy!r})
"""


@pytest.fixture
def copy(tmp_path):
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True)
    if listed.returncode:
        pytest.skip("not a git checkout, so its files cannot be listed")
    for name in listed.stdout.splitlines():
        if (ROOT / name).is_file() and not name.startswith("tests/benchmarks/"):
            (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(ROOT / name, tmp_path / name)
    return tmp_path


def python(copy: Path, code: str) -> str:
    """Run `code` against the copy; return what it prints."""
    whole = IN_COPY.format(copy=str(copy)) + dedent(code)
    done = subprocess.run([sys.executable, "-c", whole], cwd=copy, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    return done.stdout


def suite(copy: Path, *arguments: str) -> None:
    """Run a part of the copy's own tests."""
    options = ["-q", "-p", "no:cacheprovider", *arguments]
    python(copy, f"import pytest; sys.exit(pytest.main({options!r}))")


def add(copy: Path, name: str, text: str) -> None:
    assert not (copy / name).exists()
    (copy / name).write_text(dedent(text).lstrip())


def command(copy: Path, *arguments: str) -> str:
    """Run the command line of the copy; return its standard output."""
    return python(copy, f"sys.argv = {['spike4dgs', *arguments]!r}; from server.cli.main import main; main()")


def test_an_image_method_is_one_file(copy):
    add(
        copy,
        "reconstruction/images/methods/halves.py",
        '''
        """Halves: TFP's picture at half its light, an example of an image method."""

        from dataclasses import replace

        from acquisition.spikes.stream import SpikeStream
        from reconstruction.images.catalogue import Estimate, ImageMethod
        from reconstruction.images.methods.tfp import tfp


        def halves(stream: SpikeStream, plane: int) -> Estimate:
            """Return TFP's picture of `stream` at `plane` at half its light."""
            whole = tfp(stream, plane)
            return replace(whole, intensity=whole.intensity / 2)


        METHOD = ImageMethod("halves", halves, price_s=0.0005)
        ''',
    )
    for name in ("images", "reconstruct"):
        assert "halves" in command(copy, name, "--help")
    command(copy, "simulate", "--scene", "flat", "--ticks", "40", "--size", "16x10", "--out", "rec")
    command(
        copy, "images", "rec/cam11.dat", "--size", "16x10", "--tick-rate", "20000", "--method", "halves", "--out", "p"
    )
    assert list((copy / "p").glob("*.npy"))
    suite(copy, "tests/architecture/test_layout.py", "tests/architecture/test_words.py", "-k", "halves or docstring")


def test_a_camera_profile_is_one_file(copy):
    add(
        copy,
        "acquisition/devices/profiles/tiny.py",
        '''
        """A camera with a short queue of transfers, an example of a profile."""

        from acquisition.devices.profile import Profile

        TINY = Profile("tiny", 0x1209, 0x7A9F, interface=0, stream_endpoint=0x81, in_flight=4)
        ''',
    )
    simulate = ("--scene", "flat", "--ticks", "40", "--size", "16x10")
    command(copy, "simulate", *simulate, "--out", "rec")
    record = (
        "record",
        "--rig",
        "rec/rig.toml",
        "--devices",
        "mock:flat?profile=tiny",
        "--ticks",
        "40",
        "--out",
        "again",
    )
    command(copy, *record)
    command(copy, "verify", "again")
    suite(
        copy,
        "tests/contract/test_cameras.py",
        "-k",
        "MockBench-tiny and (bit_for_bit or again or full_kernel or idle_only or fit_the_rig)",
    )


def test_a_supervision_term_is_two_files(copy):
    add(
        copy,
        "reconstruction/losses/fourth.py",
        '''
        """The mean fourth power of a difference of rates."""

        from torch import Tensor


        def fourth_loss(light: Tensor, rate: Tensor, planes: int, noise: Tensor | float = 1.0) -> Tensor:
            """Return the mean fourth power of light less a rate, both [N] in spikes per tick."""
            return ((light - rate) ** 4).mean()
        ''',
    )
    add(
        copy,
        "reconstruction/training/supervision/fourth.py",
        '''
        """Compares rendered light with spike counts by the fourth power, an example of a supervision term."""

        from __future__ import annotations

        from typing import TYPE_CHECKING

        from reconstruction.training.term import Supervision

        if TYPE_CHECKING:
            from reconstruction.methods.definition import SpikeSampling
            from reconstruction.training.image_term import ImageTerm
            from reconstruction.training.spike_term import SpikeTerm


        def fourth_term(image: ImageTerm, sampling: SpikeSampling) -> SpikeTerm:
            """Return the term of the mean fourth power."""
            from reconstruction.losses.fourth import fourth_loss
            from reconstruction.training.spike_term import SpikeTerm

            return SpikeTerm(image, fourth_loss, sampling)


        FOURTH = Supervision("fourth", fourth_term)
        ''',
    )
    assert "fourth" in command(copy, "reconstruct", "--help")
    suite(copy, "tests/unit/reconstruction/test_supervision.py", "-k", "every_supervision and fourth")


def test_an_export_format_is_one_file_and_a_line(copy):
    add(
        copy,
        "reconstruction/export/formats/xyz.py",
        '''
        """`.xyz`: a line of text for each Gaussian at one instant, an example of an export format."""

        from reconstruction.export.splats import Splats, splat_format


        def xyz_bytes(splats: Splats) -> bytes:
            """Return the bytes of a file: x, y, z in metres, rig frame."""
            return "".join(f"{x:.6f} {y:.6f} {z:.6f}\\n" for x, y, z in splats.means).encode()


        XYZ = splat_format("xyz", "where the Gaussians are", xyz_bytes)
        ''',
    )
    readme = copy / "reconstruction/README.md"
    readme.write_text(
        readme.read_text().replace("| `ply` |", "| `xyz` | where the Gaussians are | `--at` |\n| `ply` |", 1)
    )
    assert "xyz" in command(copy, "export", "--help")
    code = "from server.schemas.job_types import ExportRequest; print(ExportRequest.model_json_schema())"
    assert "xyz" in python(copy, code)
    suite(copy, "tests/unit/reconstruction/test_export_paths.py", "-k", "xyz or readme")
