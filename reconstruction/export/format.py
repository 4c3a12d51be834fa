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

    `about` says in a line what it is. `file` names what an export job writes into its own folder: a file, or where the
    name has no suffix a folder with a manifest. `write(path, scene, choices, progress)` makes it and returns what a
    manifest adds. `takes` lists the fields of `Choices` that matter to it. `served`: whether the service offers it.
    """

    name: str
    about: str
    file: str
    write: Writer
    takes: tuple[str, ...]
    served: bool = True

    @property
    def folder(self) -> bool:
        """Return whether it is a folder."""
        return not Path(self.file).suffix


def splat_format(name: str, about: str, encode: Callable[[Splats], bytes]) -> Format:
    """Return the format of a single file: the bytes that `encode` makes of the Gaussians at the instant chosen."""

    def write(path: Path, scene: Scene, choices: Choices, progress: Progress) -> dict:
        splats = splats_at(scene, scene.instant_s(choices))
        path.write_bytes(encode(splats))
        progress(1.0, f"{len(splats)} Gaussians")
        return {}

    return Format(name, about, f"scene.{name}", write, ("at_s",))
