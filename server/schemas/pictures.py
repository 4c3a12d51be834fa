"""Sharpness and light of cameras' pictures."""

from pydantic import BaseModel, Field

BINS = 32  # of a histogram of light, each as wide as the others


class CameraFigures(BaseModel):
    """The sharpness and light of one camera's picture, from the spikes of the planes that it was made of.

    `row` and `column` are its place in the array. Without a plane all figures are None and `histogram` is empty.
    """

    id: str
    row: int
    column: int
    width: int
    height: int
    planes: int
    focus: float | None = Field(
        default=None,
        description="Sharpness, to be compared with that of the same camera before the same scene: 1000 times the "
        "variance of the Laplacian of the smoothed picture, over the square of its mean light. Higher is sharper.",
    )
    mean: float | None = Field(default=None, description="Mean light, spikes per tick.")
    under: float | None = Field(default=None, description="Share of pixels without a spike: underexposed.")
    over: float | None = Field(default=None, description="Share of pixels that fire every tick: overexposed.")
    histogram: list[float] = Field(
        default=[], description=f"Share of pixels in each of {BINS} equal parts of 0 to 1 spikes per tick."
    )


class LookFigures(BaseModel):
    """The figures of the last look of a rig, `age_s` ago; `etag` changes with every look."""

    rig: str
    age_s: float
    etag: str
    cameras: list[CameraFigures]


class CaptureFigures(BaseModel):
    """The figures of a capture's preview, which is of its middle."""

    capture: str
    cameras: list[CameraFigures]
