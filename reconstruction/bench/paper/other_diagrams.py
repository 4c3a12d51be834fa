"""Error against run time of single images, cameras and points, out of the documents of their benches."""

from __future__ import annotations

from pathlib import Path

from reconstruction.bench.paper.axes import caption, db_scale, log_axes, marks, new_figure, relative_error, write_figure

LEAST_S = 0.05  # where the rig as drawn stands, which takes no time
BARS = "Mark: median; bar: lowest to highest of recordings."


def image_methods(path: Path, document: dict) -> bool:
    """Error of an image against the time it takes, at full light and rate."""
    rows = [r for r in document["rows"] if r.get("part") == "scenes" and r.get("light") == 1 and "psnr_db" in r]
    rows = [r for r in rows if r.get("rate_by") == "full"]
    errors = {r["method"]: [] for r in rows}
    for row in rows:
        errors[row["method"]].append((row["seconds"], float(relative_error(row["psnr_db"]))))
    return _spread(path, document, rows, errors, ("Spikes to images", "seconds an image", "RMS error / white  (PSNR)"))


def pose_methods(path: Path, document: dict, metric: str, name: str, title: str) -> bool:
    """An error of cameras or points against the time they take, of the runs from the usual nominal rig."""
    rows = [r for r in document["rows"] if metric in r and r.get("views") == 9 and "planes" not in r]
    rows = [r for r in rows if "abs_rel" in r and r[metric] > 0]
    errors = {r["method"]: [] for r in rows}
    for row in rows:
        errors[row["method"]].append((max(row["seconds"], LEAST_S), row[metric]))
    return _spread(path, document, rows, errors, (title, "wall seconds, images included", name))


def _spread(
    path: Path,
    document: dict,
    rows: list[dict],
    found: dict[str, list[tuple[float, float]]],
    names: tuple[str, str, str],
) -> bool:
    """A mark for each method at its median time."""
    if not rows:
        return False
    title, x, y = names
    figure, axes = new_figure(f"{title}: error against run time")
    for number, (method, pairs) in enumerate(found.items()):
        seconds = sorted(t for t, _ in pairs)
        marks(axes, [seconds[len(seconds) // 2]], [[error for _, error in pairs]], number, method)
    log_axes(axes, x, y)
    if "PSNR" in y:
        db_scale(axes)
    write_figure(path, figure, caption(document, rows, BARS))
    return True
