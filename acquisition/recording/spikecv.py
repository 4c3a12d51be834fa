"""Reads and writes SpikeCV's `config.yaml`, the sidecar of its `.dat` files, which holds their size."""

from pathlib import Path

import yaml

from acquisition.durable import write_durably
from acquisition.errors import BadRecordingError
from acquisition.recording.manifest import Manifest

CONFIG_FILE = "config.yaml"


def read_size(path: Path) -> tuple[int, int]:
    """Read how many columns are stored, and how many rows, from the `config.yaml` at `path`.

    Raises BadRecordingError naming the file and the missing or wrong field.
    """
    try:
        with BadRecordingError.reading(path, "give SpikeCV's config.yaml"):
            document = yaml.safe_load(path.read_bytes())
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise BadRecordingError("found text that is not YAML", "SpikeCV's config.yaml", where=path) from error
    if not isinstance(document, dict) or not {"spike_w", "spike_h"} <= document.keys():
        raise BadRecordingError("found no spike_w and spike_h", "SpikeCV's config.yaml", where=path)
    for name in ("spike_w", "spike_h"):
        value = document[name]
        if type(value) is not int or not 1 <= value <= 9999:
            raise BadRecordingError(f"found {name}: {str(value)[:40]}", "a whole number of pixels", where=path)
    return document["spike_w"], document["spike_h"]


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
    document = {
        "filename": recording.resolve().name,
        "spike_w": width,
        "spike_h": height,
        "is_labeled": False,
        "labeled_data_type": [0],  # SpikeCV's number for spikes without labels
        "labeled_data_suffix": "None",
    }
    write_durably(path, yaml.safe_dump(document, sort_keys=False, default_flow_style=None))
    return path
