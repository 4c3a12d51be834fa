"""The definition of an export format; it needs no torch."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from acquisition.progress import Progress
from reconstruction.export.scene import Choices, Scene
from reconstruction.export.splats import Splats, splats_at

Writer = Callable[[Path, Scene, Choices, Progress], dict]


@dataclass(frozen=True)
class Format:
    """A form in which other tools read a run; a file of `reconstruction.export.formats` defines one.

    `about` says in a line what it is. `file` names what an export job writes into its own folder. `takes` lists the
    fields of `Choices` that matter to it. `folder` says that it is a folder with a manifest. `served` says whether the
    service offers it. `write(path, scene, choices, progress)` makes the file or folder, which does not exist yet, and
    returns what a folder's manifest adds.
    """

    name: str
    about: str
    file: str
    write: Writer
    takes: tuple[str, ...]
    folder: bool = False
    served: bool = True


def splat_writer(encode: Callable[[Splats], bytes]) -> Writer:
    """Return the writer of a single file: the bytes that `encode` makes of the Gaussians at the instant chosen."""

    def write(path: Path, scene: Scene, choices: Choices, progress: Progress) -> dict:
        splats = splats_at(scene, scene.instant_s(choices))
        path.write_bytes(encode(splats))
        progress(1.0, f"{len(splats)} Gaussians")
        return {}

    return write
