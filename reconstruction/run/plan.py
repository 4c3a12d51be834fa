"""Looks at the spikes once and decides what this scene needs; lists all that it leaves out, each with its reason."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from acquisition.progress import Progress, part, silent
from acquisition.spikes.stream import SpikeStream
from reconstruction.errors import BadRunError
from reconstruction.images.flicker import Light, estimate_light
from reconstruction.images.methods.interpolated import PLANES
from reconstruction.images.scarce import SCARCE, lit_spikes
from reconstruction.methods.catalogue import METHODS
from reconstruction.methods.definition import SWEEPS, Method
from reconstruction.run.configuration import EVEN, MAPS, ReconstructionConfig
from reconstruction.run.decisions import Decision, Plan
from reconstruction.run.prices import FLOAT_BYTES, KEPT_COPIES, Work
from reconstruction.run.span_plan import UNADJUSTED, choose_spans, find_spans, say_spans, shares_of
from reconstruction.run.spans import STILL_SHARE
from reconstruction.run.start_plan import choose_init, choose_points, init_of
from rigs.rig import Rig

DARK_RATE = 1e-4  # spikes per pixel and tick below which a view carries no picture
LEAST_VIEWS = 2  # training views
TWIN_PLANES = 32  # first planes of two streams, which tell whether they are one
LIGHT_SHARE, MASKS_SHARE = 0.3, 0.9  # shares of the time after which light, and movers, are found
LIGHT_VIEWS = 4  # views that are enough to see the light of the whole scene
LEAST_WINDOW = 7  # planes of a short image
WINDOW_S, WINDOW_SPIKES = 1e-3, 0.35  # most seconds of a short image, and spikes that it should hold
COARSE_PX = 100_000  # least pixels of a picture that was made smaller
COARSE_UNTIL = 0.75  # share of the training after which pictures are whole
GAUSSIAN_FLOATS = 12  # numbers of a still Gaussian
MOVING = 2.5  # times the share of the pixels that move: the share of the Gaussians that do
LEAST_MOVING, MOST_MOVING = 0.1, 0.6  # of all Gaussians
STILL_ONCE = 2  # times as many still Gaussians where several spans share what stands still
BEST_METHOD = "adaptive"  # best image method without a network, on single images


def make_plan(
    config: ReconstructionConfig, rig: Rig, streams: Mapping[str, SpikeStream], progress: Progress = silent
) -> tuple[Plan, dict[str, NDArray[np.bool_]], Light]:
    """Return the plan, each training view's masks of moving pixels by span [S, H, W], and the light.

    Reads no stream but those of the training views. Raises BadRunError for what cannot be done.
    """
    decisions: list[Decision] = []
    views = _training_views(config, rig, streams, decisions)
    light = _light([streams[view] for view in views], decisions)
    seen = {view: streams[view] for view in views}
    spans = choose_spans(config, init_of(config, rig), list(seen.values()))
    progress(LIGHT_SHARE, "light")
    spans, masks = find_spans(seen, light, spans, part(progress, LIGHT_SHARE, MASKS_SHARE))
    if len(spans) > 1:
        decisions.append(say_spans(spans, shares_of(masks), _share(masks)))
    elif config.span is not None and config.span < len(streams[views[0]]):
        reason = "it is at rest, or learnt by what spans do not know: see the supervision, model, refinement and points"
        decisions.append(Decision("spans", "one, the whole", reason, "--span"))
    _say_scarce([streams[view] for view in views], decisions)
    work = _work(config, rig, streams, views)
    model = _choose_model(config, masks, work, decisions)
    method = METHODS[model]
    if config.gaussians is None:
        work = work.with_gaussians(method.gaussians, len(spans))
    _refuse_for_rays(config, method)
    if not method.moves:
        masks = {view: np.zeros_like(mask) for view, mask in masks.items()}
    images, supervision = _choose_targets(config, work, _share(masks), method, decisions)
    still, moving = _split(work.gaussians, method, masks, capped=config.gaussians is not None)
    decisions += _economies(config, work, _share(masks), (still, moving))
    grey = "a spike carries no colour; against three channels of third-degree harmonics"
    colour = "one grey channel, no view dependence", grey, "none"
    decisions.append(Decision("colour", *colour, saves_bytes=work.colour_bytes()))
    pixels = _choose_pixels(config, rig, views, decisions)
    init = choose_init(config, rig, work, decisions)
    points = choose_points(config, init, method, decisions)
    refine = config.refine == "on" or (config.refine == "auto" and init in UNADJUSTED and not method.rays)
    ever = {view: np.logical_or.reduce(mask) for view, mask in masks.items()}
    window = _choose_window(config, images, rig, streams, ever, decisions)
    doublings = _choose_sizes(work, method, decisions)
    own = {"init": init, "points": points, "refine": refine, "pixels": pixels, "window": window, "doublings": doublings}
    own |= {"spans": spans if len(spans) > 1 and method.moves else ()}
    own |= {"sweeps": SWEEPS if own["spans"] else method.sweeps}
    return Plan(views, model, images, supervision, moving, still, tuple(decisions), **own), masks, light


def _refuse_for_rays(config: ReconstructionConfig, method: Method) -> None:
    """Refuse what a radiance field cannot do: it learns from the spikes of single rays of cameras that stand still."""
    if method.rays and config.refine == "on":
        raise BadRunError(f"found --refine on with --model {method.name}, which cannot refine poses", do="leave it out")
    if method.rays and config.supervision != "auto":
        raise BadRunError(
            f"found --supervision {config.supervision} with --model {method.name}, which learns from single rays",
            do="leave it out",
        )


def _work(config: ReconstructionConfig, rig: Rig, streams: Mapping[str, SpikeStream], views: Sequence[str]) -> Work:
    camera, planes = rig.camera(views[0]), min(len(streams[view]) for view in views)
    size = camera.width * camera.height
    return Work(size, planes, len(views), config.gaussians or 0, config.budget_s, config.steps)


def _share(masks: Mapping[str, NDArray[np.bool_]]) -> float:
    """Return the share of the pixels that move, in the mean over the spans in which anything does."""
    shares = shares_of(masks)
    return float(np.mean(shares[shares >= STILL_SHARE])) if (shares >= STILL_SHARE).any() else float(shares.mean())


def _choose_targets(
    config: ReconstructionConfig, work: Work, share: float, method: Method, decisions: list[Decision]
) -> tuple[str, str]:
    images, supervision = config.images, config.supervision
    if images == "auto":
        images, count = "interpolated", work.images(config.tick_stride)
        gap_s = work.image_s(BEST_METHOD) - work.image_s(images)
        reason = f"long mean where nothing moves, short interpolated count where something does, not {BEST_METHOD}"
        decisions.append(Decision("images", images, reason, "--images", count * gap_s if share else None))
    if supervision == "auto" and method.supervision != "pixels":
        supervision = method.supervision
        decisions.append(Decision("supervision", supervision, f"as {method.name} is published", "--supervision"))
    elif supervision == "auto":
        supervision = "pixels"
        reason = "at equal time no spike term gained on the development scenes; one renders three instants a step"
        decisions.append(Decision("supervision", supervision, reason, "--supervision", work.instants_s()))
    return images, supervision


def _say_scarce(streams: Sequence[SpikeStream], decisions: list[Decision]) -> None:
    """Say where pixels are judged in squares, because they fire too seldom (`images.scarce`)."""
    spikes = [lit_spikes(stream) for stream in streams]
    if seldom := sum(n < SCARCE for n in spikes):
        reason = f"{np.mean(spikes):.1f} spikes a lit pixel in the clip, fewer than {SCARCE:g} in {seldom} views"
        facts = {"spikes": float(np.mean(spikes)), "views": seldom}
        decisions.append(Decision("few spikes", "counts of squares of pixels tell movers", reason, "none", facts=facts))


def _choose_window(
    config: ReconstructionConfig,
    images: str,
    rig: Rig,
    streams: Mapping[str, SpikeStream],
    masks: Mapping[str, NDArray[np.bool_]],
    decisions: list[Decision],
) -> int:
    """Return the planes of a short image: nine, more where a pixel fires seldom, fewer where a plane is long."""
    lit = [
        streams[v].counts(0, len(streams[v]))[mask].mean() / len(streams[v]) for v, mask in masks.items() if mask.any()
    ]
    if images != "interpolated" or not lit:
        if config.window:
            reason = "nothing moves" if not lit else f"the images are {images}"
            decisions.append(Decision("windows", f"{config.window} planes, not used", reason, "--window"))
        return PLANES
    rate = max(float(np.mean(lit)), 1e-9)
    most = max(LEAST_WINDOW, _odd(WINDOW_S * rig.tick_rate_hz))
    window = config.window or min(max(PLANES, _odd(WINDOW_SPIKES / rate)), most)
    span = f"{1000 * window / rig.tick_rate_hz:.2g} ms, {window * rate:.2g} spikes a moving pixel"
    facts = {"planes": window, "spikes_a_plane": rate}
    decisions.append(
        Decision("windows", f"{window} planes", f"an image of movers spans {span}", "--window", facts=facts)
    )
    return window


def _choose_sizes(work: Work, method: Method, decisions: list[Decision]) -> tuple[float, ...]:
    """Return the shares of the training at which pictures double in width and height; none where they are small."""
    halvings = 0
    while not method.rays and work.pixels / 4 ** (halvings + 1) >= COARSE_PX:
        halvings += 1
    if halvings:
        spared_s, size = work.halving_s(COARSE_UNTIL), f"{2**halvings} times smaller"
        choice = f"{size} at first, whole after {COARSE_UNTIL:.0%} of the training"
        reason = "a step costs what it draws, and smaller pictures teach as much until little is left to learn"
        decisions.append(Decision("picture sizes", choice, reason, "none", spared_s, facts={"halvings": halvings}))
    return tuple(COARSE_UNTIL * (i + 1) / halvings for i in range(halvings))


def _odd(planes: float) -> int:
    """Return the largest odd number up to `planes`, at least 1."""
    return max(1, (int(min(planes, 10_000)) - 1) // 2 * 2 + 1)


def _economies(config: ReconstructionConfig, work: Work, share: float, counts: tuple[int, int]) -> list[Decision]:
    """Return what is kept small from the start: the instants and the Gaussians."""
    stride, (still, moving) = config.tick_stride, counts
    fewer = work.images(1) - work.images(stride)
    kept = round(fewer * work.pixels * share) * FLOAT_BYTES
    image_s = work.image_s(config.images if config.images != "auto" else "interpolated")
    spared = (fewer * image_s, kept) if fewer and share else (None, None)
    reason = f"{work.images(stride)} target images are drawn again and again, not {work.images(1)} for every plane"
    every = f"an image every {stride} planes"
    splats = f"{still:,} still and {moving:,} moving"
    cost = (work.splats_s(), GAUSSIAN_FLOATS * FLOAT_BYTES * KEPT_COPIES * work.gaussians)
    return [
        Decision("instants", every, reason, "--tick-stride", *spared),
        Decision("Gaussians", splats, "against twice as many", "none", *cost),
    ]


def _choose_pixels(config: ReconstructionConfig, rig: Rig, views: Sequence[str], decisions: list[Decision]) -> str:
    """Return what is taken of single pixels; raises BadRunError where maps are asked for and none is there."""
    calibrated = sum(rig.camera(view).pixels is not None for view in views)
    if config.pixels == MAPS and not calibrated:
        raise BadRunError("found --pixels maps and no map", "a calibrated rig", "run `spike4dgs calibrate --pixels`")
    pixels = config.pixels if config.pixels != "auto" else MAPS if calibrated else EVEN
    choice, reason = "taken as even", "the recording has no maps; `spike4dgs calibrate --pixels` makes them"
    if pixels == MAPS:
        choice, reason = "evened out by maps", f"{calibrated} of {len(views)} views have a calibration of their pixels"
    elif calibrated:
        reason = f"maps of {calibrated} views are there, and were not asked for"
    decisions.append(Decision("pixels", choice, reason, "--pixels"))
    return pixels


def _training_views(
    config: ReconstructionConfig, rig: Rig, streams: Mapping[str, SpikeStream], decisions: list[Decision]
) -> tuple[str, ...]:
    if config.holdout is not None:
        rig.camera(config.holdout)
    asked = config.views or tuple(c for c in rig.ids if c != config.holdout)
    for view in asked:
        rig.camera(view)
    _refuse_twins(asked, streams)
    lit = []
    for view in asked:
        stream = streams[view]
        rate = stream.counts(0, len(stream)).mean() / len(stream)
        if rate < DARK_RATE and view not in config.views:
            reason, spared_s = f"{rate:.1e} spikes per tick: no light", _work(config, rig, streams, [view]).view_s()
            decisions.append(Decision("views", f"{view} skipped", reason, "--views", spared_s))
        else:
            lit.append(view)
    _refuse_odd(rig, lit)
    if len(lit) < LEAST_VIEWS:
        raise BadRunError(
            f"found {len(lit)} training views with light", f"{LEAST_VIEWS} or more", "record again or name others"
        )
    return tuple(lit)


def _refuse_odd(rig: Rig, views: Sequence[str]) -> None:
    """Refuse pictures of several sizes, which no stage compares."""
    sizes = {view: (rig.camera(view).width, rig.camera(view).height) for view in views}
    usual = max(set(sizes.values()), key=list(sizes.values()).count, default=None)
    odd = {view: size for view, size in sizes.items() if size != usual}
    if odd and usual:
        named = ", ".join(f"{view} {width}x{height}" for view, (width, height) in odd.items())
        expected = f"{usual[0]}x{usual[1]} px, as the other views"
        raise BadRunError(f"found pictures of several sizes: {named}", expected, "leave those out with --views")


def _refuse_twins(views: Sequence[str], streams: Mapping[str, SpikeStream]) -> None:
    """Refuse one file under two names: two cameras that see light never fire alike."""
    seen: dict[bytes, str] = {}
    for view in views:
        planes = streams[view].window(0, min(TWIN_PLANES, len(streams[view])))
        if not planes.any():
            continue
        twin = seen.setdefault(planes.tobytes(), view)
        if twin != view:
            raise BadRunError(f"found the same spikes in {twin} and {view}", "one stream a camera", "import again")


def _light(streams: Sequence[SpikeStream], decisions: list[Decision]) -> Light:
    light = estimate_light(streams[:LIGHT_VIEWS])
    choice, reason = "steady: no gains", "still pixels see no flicker"
    if light.flickers:
        choice, reason = (
            "one gain a plane",
            f"still pixels see {light.gains.min():.2f} to {light.gains.max():.2f} of the mean light",
        )
    decisions.append(Decision("light", choice, reason, "none"))
    return light


def _choose_model(
    config: ReconstructionConfig, masks: Mapping[str, NDArray[np.bool_]], work: Work, decisions: list[Decision]
) -> str:
    if config.model != "auto":
        return config.model
    share = float(shares_of(masks).max())
    if share < STILL_SHARE:
        reason = f"{share:.2%} of the pixels change: no motion model"
        decisions.append(Decision("motion", "static", reason, "--model", work.movers_s()))
        return "static"
    reason = f"{share:.1%} of the pixels change; straight paths instead where bodies explain the counts no better"
    decisions.append(Decision("motion", "bases", reason, "--model"))
    return "bases"


def _split(usual: int, method: Method, masks: Mapping[str, NDArray[np.bool_]], *, capped: bool) -> tuple[int, int]:
    """Split `usual` Gaussians: movers get more than their share of pixels; spans, if not `capped`, more still ones."""
    if not method.moves:
        return usual, 0
    moving = round(usual * min(MOST_MOVING, max(LEAST_MOVING, MOVING * _share(masks))))
    spans = max(map(len, masks.values()))
    return (usual - moving) * (STILL_ONCE if spans > 1 and not capped else 1), moving
