"""Lays out the scores of a run beside its floors; light enough for a process without torch."""

from dataclasses import dataclass

COLUMNS = {
    "psnr_db": ("PSNR / dB", "{:.2f}"),
    "ssim": ("SSIM", "{:.3f}"),
    "dynamic_psnr_db": ("PSNR of movers / dB", "{:.2f}"),
    "abs_rel": ("depth Abs Rel", "{:.4f}"),
    "delta_1_25": ("depth delta < 1.25", "{:.3f}"),
    "counts.mae": ("count error, mean / spikes", "{:.3f}"),
    "counts.rmse": ("count error, RMS / spikes", "{:.3f}"),
}
LINES = {"reconstruction": "", "depth-warped blend": "depth_blend.", "nearest view": "nearest_view."}
WORDS = {  # for who reads such a table for the first time
    "depth-warped blend": "the training images, carried to this view by the depth of the points and blended",
    "nearest view": "the image of the training camera that stands nearest",
    "depth Abs Rel": "the mean error of depth, as a share of it",
    "depth delta < 1.25": "the share of pixels whose depth is right to a factor of 1.25",
    "count error, mean / spikes": "spikes of a pixel in 32 planes, recorded against rendered; noise is part of it",
}


@dataclass(frozen=True)
class ScoreTable:
    """Headings of the columns, and lines: a name and one cell a column ("-" where there is no score)."""

    headings: tuple[str, ...]
    lines: tuple[tuple[str, tuple[str, ...]], ...]

    @property
    def words(self) -> dict[str, str]:
        """The meaning of the names of lines and columns that a newcomer cannot know."""
        names = (*(name for name, _ in self.lines), *self.headings)
        return {name: WORDS[name] for name in names if name in WORDS}


def score_table(metrics: dict) -> ScoreTable:
    """Return the table of a `metrics.json` document; columns and lines without any score are left out."""
    columns = {key: spec for key, spec in COLUMNS.items() if key in metrics}
    lines = []
    for name, prefix in LINES.items():
        scores = [(metrics.get(prefix + key), form) for key, (_, form) in columns.items()]
        if any(score is not None for score, _ in scores):
            lines.append((name, tuple("-" if score is None else form.format(score) for score, form in scores)))
    return ScoreTable(tuple(heading for heading, _ in columns.values()), tuple(lines))
