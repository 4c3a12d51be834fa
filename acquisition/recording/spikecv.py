"""Reads and writes SpikeCV's `config.yaml`, the sidecar of its `.dat` files, which holds their size."""

import dataclasses
from dataclasses import dataclass
from pathlib import Path

import yaml

from acquisition.durable import write_durably
from acquisition.errors import BadRecordingError
from acquisition.recording.manifest import Manifest

CONFIG_FILE = "config.yaml"
_RAW = 0  # SpikeCV's number for spikes without labels


@dataclass(frozen=True)
class SpikeCVConfig:
    """The fields of a `config.yaml`; `spike_w` counts stored columns, `labeled_data_type` holds SpikeCV's numbers."""

    filename: str
    spike_w: int
    spike_h: int
    is_labeled: bool = False
    labeled_data_type: tuple[float, ...] = (_RAW,)
    labeled_data_suffix: str | None = None

    def __post_init__(self) -> None:
        for name in ("spike_w", "spike_h"):
            value = getattr(self, name)
            if type(value) is not int or not 1 <= value <= 9999:
                raise BadRecordingError(f"found {name}: {str(value)[:40]}", "a whole number of pixels")
        if any(type(kind) not in (int, float) for kind in self.labeled_data_type):
            raise BadRecordingError(f"found labeled_data_type: {self.labeled_data_type}", "a list of numbers")


def read_config(path: Path) -> SpikeCVConfig:
    """Read the `config.yaml` at `path`; raises BadRecordingError naming the file and the missing or wrong field."""
    try:
        with BadRecordingError.reading(path, "give SpikeCV's config.yaml"):
            document = yaml.safe_load(path.read_bytes())
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise BadRecordingError("found text that is not YAML", "SpikeCV's config.yaml", where=path) from error
    if not isinstance(document, dict) or not {"spike_w", "spike_h"} <= document.keys():
        raise BadRecordingError("found no spike_w and spike_h", "SpikeCV's config.yaml", where=path)
    kinds = document.get("labeled_data_type", [_RAW])
    suffix = document.get("labeled_data_suffix")
    with BadRecordingError.located(path):
        return SpikeCVConfig(
            str(document.get("filename", "")),
            document["spike_w"],
            document["spike_h"],
            document.get("is_labeled") is True,
            tuple(kinds) if isinstance(kinds, list) else (kinds,),
            None if suffix in (None, "None") else str(suffix),
        )


def dump_config(config: SpikeCVConfig) -> str:
    """Return the config as SpikeCV reads it; `read_config` of it gives the same."""
    document = dataclasses.asdict(config)
    document["labeled_data_type"] = list(config.labeled_data_type)
    document["labeled_data_suffix"] = config.labeled_data_suffix or "None"
    return yaml.safe_dump(document, sort_keys=False, default_flow_style=None, allow_unicode=False)


def write_config(recording: Path, manifest: Manifest) -> Path:
    """Write the `config.yaml` of a recording beside its planes, for SpikeCV; returns where.

    Raises BadRecordingError where the cameras differ in size, or store their bits in an order SpikeCV does not read.
    """
    sizes = {(camera.layout.stored_width, camera.layout.height) for camera in manifest.cameras}
    if len(sizes) > 1:
        raise BadRecordingError(f"found cameras of {len(sizes)} sizes", "one for a config.yaml", where=recording)
    if any(camera.layout.bit_order != "lsb" for camera in manifest.cameras):
        raise BadRecordingError("found planes stored msb first", "lsb, which is all SpikeCV reads", where=recording)
    width, height = sizes.pop()
    path = recording / CONFIG_FILE
    write_durably(path, dump_config(SpikeCVConfig(recording.resolve().name, width, height)))
    return path
