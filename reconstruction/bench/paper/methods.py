"""Builds the methods of the paper's tables, named as it names them: images, poses, model, spike loss.

In every one the still pixels are our long mean; the image source is that of the movers. The points are our plane
sweep's, but where a name has others. The chain is the paper's as we read it, with a small field.
Networks make an image in half a second, so their rows have targets at every 40th plane only.
"""

from reconstruction.bench.conventions import RATE_HZ, VIEWS
from reconstruction.bench.paper.method import Change, Method
from reconstruction.bench.paper.published import IMAGE_MODELS, QUICK_MODELS, SPIKE_MODELS
from reconstruction.bench.streams import Slowing
from reconstruction.images.catalogue import GIVEN as IMAGES_GIVEN
from reconstruction.run.configuration import FOUND as EXCHANGED
from reconstruction.run.configuration import RANDOM, SUPERVISIONS, SWEPT

APART = ("variation",)  # `bench spss` measures it by weight
SPIKE_LOSSES = tuple(name for name in SUPERVISIONS if name not in ("pixels", *APART))
NOMINAL = Change(nominal=True)
CAPS = (3000, 6000, 12_000, 24_000, 96_000)  # most Gaussians, beside the default

AUTO = Method("auto")
_LEARNERS = sorted({*IMAGE_MODELS.values(), *QUICK_MODELS.values()})
TFI = {model: Method(f"tfi+{model}", {"model": model, "images": "tfi"}) for model in _LEARNERS}
SPIKES = {model: Method(model, {"model": model}) for model in SPIKE_MODELS.values()}
SPK2IMGNET = {
    model: Method(f"spk2imgnet+{model}", {"model": model, "images": "spk2imgnet", "tick_stride": 40})
    for model in _LEARNERS
}

FOUND = Method("natural+auto", {"init": "natural"}, NOMINAL)
_SMALL = {"model": "4dgs-small"}
_MSDI = Method("msdi-points+4dgs-small", _SMALL | {"images": "msdi", "init": "msdi", "tick_stride": 40}, NOMINAL)
_MSDI_COLMAP = _MSDI.changed("msdi-image+colmap+4dgs-small", init="sfm", points=SWEPT)
_OTHER_IMAGES = Method("msdi-points+4dgs-small", _SMALL | {"init": "msdi"}, NOMINAL)


def with_loss(method: Method, supervision: str) -> Method:
    """Return the method with another spike loss; `pixels` is none."""
    if supervision == "pixels":
        return method
    return method.changed(f"{method.name}+{supervision}", supervision=supervision)


LOSSES = {name: with_loss(AUTO, name) for name in ("pixels", *SPIKE_LOSSES)}
CHAIN = {name: with_loss(_MSDI, name) for name in ("variation", "pixels", "l1", "l2")}
CHAIN_COLMAP = {name: with_loss(_MSDI_COLMAP, name) for name in ("variation", "pixels")}
CHAIN_TFI_COLMAP = TFI["4dgs-small"].changed("tfi+colmap+4dgs-small", NOMINAL, init="sfm")
CHAIN_PARTS = {
    name: with_loss(method, "variation")
    for name, method in {
        "TFI images": _OTHER_IMAGES.changed("tfi+msdi-points+4dgs-small", images="tfi"),
        "our images": _OTHER_IMAGES.changed("our-images+msdi-points+4dgs-small"),
        "our poses, swept points": _MSDI.changed("msdi-image+natural+4dgs-small", init="natural", points=SWEPT),
        "swept points": _MSDI.changed("msdi+4dgs-small", points=SWEPT),
        "random points": _MSDI.changed("msdi-random+4dgs-small", points=RANDOM),
        "our bodies and training": _MSDI.changed("msdi-points+msdi-image+auto", model="auto", points=EXCHANGED),
    }.items()
}

CLEAN = Method("clean", {"images": "clean"})
BLURRED = Method("blurred", {"images": "blurred"})
ORDINARY = Method("ordinary", {"images": "ordinary"})
GIVEN = {
    images: Method(f"{images}+natural+4dgs-small", _SMALL | {"images": images, "init": "natural"}, NOMINAL)
    for images in IMAGES_GIVEN
}

MODULES = {
    "TFI images": FOUND.changed("tfi+natural+auto", images="tfi"),
    "small Spk2ImgNet images": FOUND.changed("spk2imgnet+natural+auto", images="spk2imgnet", tick_stride=40),
    "small MSDI images": FOUND.changed("msdi-image+natural+auto", images="msdi", tick_stride=40),
    "nominal poses": FOUND.changed("nominal+auto", init="sweep", refine="off"),
    "nominal poses, refined in training": FOUND.changed("refined+auto", init="sweep", refine="on"),
    "COLMAP poses": FOUND.changed("colmap+auto", init="sfm"),
    "small MSDI poses, adjusted": FOUND.changed("msdi+auto", init="msdi", points=SWEPT),
    "small MSDI poses, adjusted, and still points": FOUND.changed("msdi-points+auto", init="msdi", points=EXCHANGED),
    "COLMAP poses and still points": FOUND.changed("colmap-points+auto", init="sfm", points=EXCHANGED),
    "random points": FOUND.changed("random-points+auto", points=RANDOM),
    "straight paths": FOUND.changed("natural+linear", model="linear"),
    "small HexPlane field": FOUND.changed("natural+4dgs-small", model="4dgs-small"),
}


def slower(method: Method, every: int, slowing: Slowing) -> Method:
    """Return the method on so many times fewer planes a second.

    To gather single planes changes nothing: such a row is run in one sitting with those that gather several.
    """
    if every == 1 and slowing == "drop":
        return method
    return method.changed(f"{method.name}.{slowing}{RATE_HZ // every}", Change(every=every, slowing=slowing))


def seeing(method: Method, views: int) -> Method:
    """Return the method on so many training views, those nearest to the held-out one."""
    if views == len(VIEWS):
        return method
    return method.changed(f"{method.name}.views{views}", views=VIEWS[:views])


def capped(method: Method, gaussians: int) -> Method:
    """Return the method with at most so many Gaussians."""
    return method.changed(f"{method.name}.gaussians{gaussians}", gaussians=gaussians)
