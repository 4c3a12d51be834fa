"""Scores the spans of a long run on as many instants as a part that is reconstructed alone."""

from collections.abc import Sequence

from reconstruction.bench.speed.run import SCORES
from reconstruction.evaluation.evaluate import INSTANTS, score_at
from reconstruction.pipeline.judged import Trained
from reconstruction.truth import spread


def scored_spans(trained: Trained, told: Sequence[dict]) -> list[dict]:
    """Return the rows of spans that a report `told`, with scores and their number of `instants` in place of its own.

    The report takes fewer instants of a span than of a whole recording. A span without truth has no scores.
    """
    camera, truth = trained.held_out, trained.truth
    if camera is None or truth is None:
        return list(told)
    rows, known = [], truth.planes(camera.camera.id)
    for row, span in zip(told, trained.run.plan.spans, strict=True):
        planes = spread([plane for plane in known if span.first <= plane < span.last], INSTANTS)
        scores = score_at(trained.cloud, camera, truth, planes) if planes else {}
        rest = {key: value for key, value in row.items() if key not in SCORES}
        rows.append(rest | {name: scores[name] for name in SCORES if name in scores} | {"instants": len(planes)})
    return rows
