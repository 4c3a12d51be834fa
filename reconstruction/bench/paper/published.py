"""Lists the figures that the authors of Spike4DGS put on record (NeurIPS 2025): their scenes, their machine.

No scene of theirs is public, so no figure here was measured on a scene of ours. PSNR and SSIM are means over five CARLA
scenes; BRISQUE and NIQE are of real recordings, which have no truth; `seconds` are of one RTX 4090 (training) or A6000.
"""

from collections.abc import Mapping

Figures = Mapping[str, float]
# The models of the published tables by their published name, as `--model` has them: learning from images, from spikes.
IMAGE_MODELS = {"D3DGS": "d3dgs", "STG": "stg", "4DGS": "4dgs"}
QUICK_MODELS = {**IMAGE_MODELS, "4DGS": "4dgs-small"}  # those that make enough steps in a minute of two cores
SPIKE_MODELS = {
    "Dy-SpikeGS": "dy-spikegs",
    "SpikeGS": "spikegs",
    "SpikeNeRF": "spikenerf",
    "Dy-SpikeNeRF": "dy-spikenerf",
}


def quality(psnr_db: float, ssim: float | None = None, minutes: float | None = None) -> Figures:
    """Return the figures that were published of a row, by metric."""
    found = {"psnr_db": psnr_db, "ssim": ssim, "seconds": None if minutes is None else 60 * minutes}
    return {key: value for key, value in found.items() if value is not None}


def _depth(abs_rel: float, delta_1_25: float) -> Figures:
    return {"abs_rel": abs_rel, "delta_1_25": delta_1_25}


def _natural(brisque: float, niqe: float) -> Figures:
    return {"brisque": brisque, "niqe": niqe}


NOVEL_VIEW: Mapping[str, Figures] = {
    "SpikeNeRF": quality(14.43, 0.576),
    "SpikeGS": quality(20.03, 0.808),
    "Dy-SpikeNeRF": quality(16.70, 0.628),
    "Dy-SpikeGS": quality(23.31, 0.835),
    "TFI + D3DGS": quality(20.34, minutes=19),
    "TFI + STG": quality(24.70, minutes=24),
    "TFI + 4DGS": quality(26.00, minutes=22),
    "TFI + COLMAP + 4DGS": quality(21.08, 0.849),
    "MSDI image + COLMAP + 4DGS": quality(22.43, 0.854),
    "MSDI image + DUSt3R + 4DGS": quality(25.76, 0.898),
    "MSDI image, points, poses + 4DGS": quality(26.66, 0.903),
    "+ L1 spike loss": quality(26.87, 0.906),
    "+ L2 spike loss": quality(26.75, 0.905),
    "MSDI image + COLMAP + SPSS": quality(23.68, 0.867),
    "MSDI image + DUSt3R + SPSS": quality(26.92, 0.907),
    "MSDI without pretraining + SPSS": quality(20.41, 0.801),
    "Spike4DGS": quality(27.74, 0.912, 25),
    "clean RGB + DUSt3R + 4DGS": quality(30.31, 0.942),
    "blurred RGB + DUSt3R + 4DGS": quality(22.72, 0.861),
}
DEPTH: Mapping[str, Figures] = {
    "Spike2img + D3DGS": _depth(0.523, 0.512),
    "Spike2img + STG": _depth(0.340, 0.538),
    "Spike2img + 4DGS": _depth(0.342, 0.536),
    "Spike4DGS": _depth(0.195, 0.565),
}
RATES: Mapping[str, Figures] = {
    "20000 Hz": quality(27.74, 0.912),
    "10000 Hz": quality(25.43, 0.885),
    "5000 Hz": quality(22.71, 0.842),
    "2000 Hz": quality(21.88, 0.810),
    "1000 Hz": quality(18.32, 0.745),
    "500 Hz": quality(16.87, 0.685),
    "200 Hz": quality(16.22, 0.650),
    "100 Hz": quality(15.54, 0.625),
}
VIEWS: Mapping[str, Figures] = {
    f"{method}, {views} views": _natural(*figures)
    for method, row in {
        "TFI + D3DGS": ((83.4, 23.87), (73.6, 21.67), (65.2, 20.81), (62.9, 18.6), (59.8, 16.20), (56.53, 15.34)),
        "TFI + STG": ((71.0, 22.8), (61.2, 17.5), (57.0, 16.7), (52.1, 14.6), (42.0, 13.1), (36.45, 10.53)),
        "TFI + 4DGS": ((70.3, 22.7), (60.8, 18.4), (56.4, 16.5), (51.8, 14.4), (43.6, 13.9), (37.57, 9.93)),
        "Spike4DGS": ((63.43, 18.54), (53.62, 15.67), (45.23, 13.81), (32.91, 11.67), (29.84, 10.2), (26.86, 9.86)),
    }.items()
    for views, figures in zip(range(3, 9), row, strict=True)
}
OUTDOORS: Mapping[str, Figures] = {  # of a moving car, a running pedestrian, a moving bicycle; here the car
    "TFI + D3DGS": _natural(60.12, 17.32),
    "TFI + STG": _natural(43.26, 13.20),
    "TFI + 4DGS": _natural(35.12, 11.24),
    "Spike4DGS": _natural(30.63, 10.32),
}
PUBLISHED: Mapping[str, Mapping[str, Figures]] = {
    "novel-view": NOVEL_VIEW,
    "depth": DEPTH,
    "rates": RATES,
    "views": VIEWS,
    "outdoors": OUTDOORS,
}
