"""Scores the spans of a long run by the parts that can be reconstructed alone, on as many instants as these."""

from collections.abc import Sequence

from reconstruction.bench.speed.run import SCORES
from reconstruction.evaluation.evaluate import INSTANTS, score_at
from reconstruction.pipeline.judged import Trained
from reconstruction.run.spans import Span, cut
from reconstruction.truth import spread


def scored_spans(trained: Trained, told: Sequence[dict]) -> list[dict]:
    """Return the rows of spans that a report `told`, with scores and their number of `instants` in place of its own.

    The report takes fewer instants of a span than of a whole recording. Where spans were joined into the one whose
    number is `span`, each of them has a row, and its share of the seconds. A span without truth has no scores.
    """
    camera, truth = trained.held_out, trained.truth
    if camera is None or truth is None:
        return list(told)
    rows, known, parts = [], truth.planes(camera.camera.id), cut(trained.recording.planes)
    for number, (row, span) in enumerate(zip(told, trained.run.plan.spans, strict=True)):
        joined = _within(span, parts)
        for part in joined:
            planes = spread([plane for plane in known if part.first <= plane < part.last], INSTANTS)
            scores = score_at(trained.cloud, camera, truth, planes) if planes else {}
            own = {key: value for key, value in row.items() if key not in SCORES}
            own |= {"instants": len(planes), "span": number, "first_tick": row["first_tick"] + part.first - span.first}
            own |= {"last_tick": own["first_tick"] + len(part) - 1, "seconds": row["seconds"] / len(joined)}
            rows.append(own | {name: scores[name] for name in SCORES if name in scores})
    return rows


def _within(span: Span, parts: Sequence[Span]) -> list[Span]:
    """Return the parts that make up the span; itself where it was cut otherwise."""
    found = [part for part in parts if span.first <= part.first and part.last <= span.last]
    return found if sum(map(len, found)) == len(span) else [span]
