"""Takes the gains of the cameras out of images and counts, where the recording tells them."""

from collections.abc import Mapping, Sequence

import numpy as np

from reconstruction.images.catalogue import GIVEN
from reconstruction.images.composite import CompositeSource
from reconstruction.initialization.gains import Gains, camera_gains
from reconstruction.initialization.sweep import DepthMap
from reconstruction.pipeline.artefacts import GAINS
from reconstruction.run.decisions import Decision
from reconstruction.run.folder import RunFolder


def even_cameras(
    run: RunFolder, sources: Mapping[str, CompositeSource], maps: Sequence[DepthMap]
) -> dict[str, CompositeSource]:
    """Return the sources with the gains of their cameras taken out, and keep these, where the plan wants it.

    They are found where backgrounds of several views agree in depth, `maps`, and left alone where that does not tell
    them, or tells that cameras are alike.
    """
    mode, given = run.config.gains, run.plan.images in GIVEN
    if mode == "off" or given:
        run.write_array(GAINS, np.ones(len(sources)))
        reason = "given images are those of nominal cameras" if given else "it was asked for"
        run.amend("points", Decision("gains", "taken as alike", reason, "--gains"))
        return dict(sources)
    views = sources.values()
    still = [source.background.trusted & ~source.moving & ~source.background.stuck for source in views]
    found = camera_gains(maps, [source.background.image for source in views], still)
    taken = bool(np.isfinite(found.sds).all()) and (found.determined or mode == "on")
    gains = np.exp(found.logs) if taken else np.ones(len(sources))
    run.write_array(GAINS, gains)
    run.amend("points", _decision(found, dict(zip(sources, gains.tolist(), strict=True)), taken=taken))
    return {view: source.dimmed(float(gain)) for (view, source), gain in zip(sources.items(), gains, strict=True)}


def _decision(found: Gains, gains: Mapping[str, float], *, taken: bool) -> Decision:
    if not np.isfinite(found.sds).all():
        return Decision("gains", "taken as alike", "too few surfaces are seen by several cameras to tell", "--gains")
    sd = float(np.sqrt(np.mean(found.sds**2)))
    seen = f"backgrounds that several see differ by {found.spread:.2%} from camera to camera, known to {sd:.2%}"
    if not taken:
        return Decision("gains", "taken as alike", seen, "--gains")
    choice = f"each camera's own, {min(gains.values()):.3f} to {max(gains.values()):.3f}"
    return Decision("gains", choice, seen, "--gains", facts={"sd": sd, **gains})
