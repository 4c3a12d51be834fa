"""The methods of the paper's tables, named as it names them: images, poses, model, spike loss.

In every one the still pixels are our long mean and the points our plane sweep; the image source is that of what moves.
Networks make an image in half a second, so their rows have targets at every 40th plane only.
"""

from __future__ import annotations

from reconstruction.bench.clips import Slowing
from reconstruction.bench.paper.method import Change, Method

MODELS = ("d3dgs", "stg", "4dgs")
FIELDS = ("spikenerf", "dy-spikenerf")
SPLATS = ("spikegs", "dy-spikegs")
SPIKES_ALONE = (("Dy-SpikeGS", "dy-spikegs"), ("SpikeGS", "spikegs"), ("SpikeNeRF", "spikenerf"))  # that stand or may
NOMINAL = Change(nominal=True)
RATE_HZ = 20000
SLOWER = (2, 4, 10, 20, 40, 100, 200)  # 20 kHz down to 100 Hz
SUPERVISIONS = ("pixels", "l1", "l2", "image-variation", "counts", "cumulative", "both")
CAPS = (3000, 6000, 12_000, 24_000, 96_000)  # of Gaussians, beside the default
VIEWS = (
    "cam01",
    "cam10",
    "cam12",
    "cam21",
    "cam00",
    "cam02",
    "cam20",
    "cam22",
)  # the nearest to the held-out one first

AUTO = Method("auto")
TFI = {model: Method(f"tfi+{model}", {"model": model, "images": "tfi"}) for model in MODELS}
SPIKES = {model: Method(model, {"model": model}) for model in (*FIELDS, *SPLATS)}
SPK2IMGNET = {
    model: Method(f"spk2imgnet+{model}", {"model": model, "images": "spk2imgnet", "tick_stride": 40})
    for model in MODELS
}

FOUND = Method("natural+auto", {"init": "natural"}, NOMINAL)
TFI_FOUND = {model: TFI[model].changed(f"tfi+natural+{model}", NOMINAL, init="natural") for model in MODELS}
TFI_COLMAP = TFI["4dgs"].changed("tfi+colmap+4dgs", NOMINAL, init="sfm")
_MSDI = Method("msdi+4dgs", {"model": "4dgs", "images": "msdi", "init": "msdi", "tick_stride": 40}, NOMINAL)
MSDI = {
    "pixels": _MSDI,
    "l1": _MSDI.changed("msdi+4dgs+l1", supervision="l1"),
    "l2": _MSDI.changed("msdi+4dgs+l2", supervision="l2"),
    "spss": _MSDI.changed("msdi+4dgs+spss", supervision="image-variation"),
}
MSDI_COLMAP = {
    "pixels": _MSDI.changed("msdi-image+colmap+4dgs", init="sfm"),
    "spss": _MSDI.changed("msdi-image+colmap+4dgs+spss", init="sfm", supervision="image-variation"),
}

CLEAN = Method("clean", {"images": "clean"})
BLURRED = Method("blurred", {"images": "blurred"})
GIVEN = {
    images: Method(f"{images}+natural+4dgs", {"model": "4dgs", "images": images, "init": "natural"}, NOMINAL)
    for images in ("clean", "blurred")
}

LOSSES = {name: Method(f"auto+{name}", {"supervision": name}) if name != "pixels" else AUTO for name in SUPERVISIONS}

MODULES = {
    "TFI images": FOUND.changed("tfi+natural+auto", images="tfi"),
    "Spk2ImgNet images": FOUND.changed("spk2imgnet+natural+auto", images="spk2imgnet", tick_stride=40),
    "MSDI images": FOUND.changed("msdi-image+natural+auto", images="msdi", tick_stride=40),
    "nominal poses": FOUND.changed("nominal+auto", init="sweep", refine="off"),
    "nominal poses, refined in training": FOUND.changed("refined+auto", init="sweep", refine="on"),
    "COLMAP poses": FOUND.changed("colmap+auto", init="sfm"),
    "MSDI poses, adjusted": FOUND.changed("msdi+auto", init="msdi"),
    "straight paths": FOUND.changed("natural+linear", model="linear"),
    "HexPlane field": FOUND.changed("natural+4dgs", model="4dgs"),
    "image variation loss": FOUND.changed("natural+auto+image-variation", supervision="image-variation"),
}


def slower(method: Method, every: int, slowing: Slowing) -> Method:
    """The method on so many times fewer planes a second."""
    if every == 1:
        return method
    return method.changed(f"{method.name}.{slowing}{RATE_HZ // every}", Change(every=every, slowing=slowing))


def seeing(method: Method, views: int) -> Method:
    """The method on the training views that are nearest to the held-out one."""
    if views == len(VIEWS):
        return method
    return method.changed(f"{method.name}.views{views}", views=VIEWS[:views])


def capped(method: Method, gaussians: int) -> Method:
    """The method with at most so many Gaussians."""
    return method.changed(f"{method.name}.gaussians{gaussians}", gaussians=gaussians)
