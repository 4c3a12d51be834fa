"""Long-window images of every view, and their features, which natural-scene calibration matches between cameras.

Cameras are synchronised, so a mover is averaged alike in all views and need not be masked.
Source: Lowe, "Distinctive image features from scale-invariant keypoints", IJCV 2004; RootSIFT: Arandjelovic &
Zisserman, CVPR 2012.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from acquisition.recording.reader import Recording
from acquisition.spikes.stream import SpikeStream
from rigs.transform import Floats

Image = NDArray[np.float32]
MOST_PLANES = 800  # averaged, in the middle of the recording
MOST_FEATURES = 2500
CONTRAST = 0.012  # least contrast of a feature, in tones of 0 to 1; noise of 100 planes stays below
ODD_SHARE = 0.25  # a pixel that differs from its neighbours by so much of the white, and by ODD_RATIO, is a defect
ODD_RATIO = 2.0


@dataclass(frozen=True, eq=False)
class Features:
    """Places [N, 2] in px and unit descriptors [N, 128] of one image."""

    places: Floats
    descriptors: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.places)


def long_image(stream: SpikeStream, most_planes: int = MOST_PLANES) -> Image:
    """Return the mean [H, W] in spikes per tick over the middle of the stream, with single odd pixels repaired."""
    first = max(0, (len(stream) - most_planes) // 2)
    last = min(len(stream), first + most_planes)
    return repaired(stream.counts(first, last).astype(np.float32) / np.float32(last - first))


def long_images(recording: Recording, views: Iterable[str], most_planes: int = MOST_PLANES) -> dict[str, Image]:
    """Return the long image of each of `views`, by camera id."""
    return {view: long_image(recording.stream(view), most_planes) for view in views}


def repaired(image: Image) -> Image:
    """Set pixels that differ much from their 3x3 neighbourhood, as dead and hot ones do, to its median."""
    median = cv2.medianBlur(image, 3)
    gap = np.abs(image - median)
    low = np.minimum(image, median)
    odd = (gap > ODD_SHARE * max(float(np.percentile(median, 99)), 1e-6)) & (gap > (ODD_RATIO - 1) * low)
    return np.where(odd, median, image)


def toned(image: Image) -> Image:
    """Return the square root of the light over its bright end, in [0, 1]: shot noise is even in it."""
    white = max(float(np.percentile(image, 99.5)), 1e-6)
    return np.sqrt(np.clip(image / np.float32(white), 0, 1))


def find_features(image: Image, where: NDArray[np.bool_] | None = None) -> Features:
    """Find at most MOST_FEATURES features of an image [H, W], all of it or `where` a mask is true."""
    mask = None if where is None else where.astype(np.uint8)
    sift = cv2.SIFT.create(
        nfeatures=MOST_FEATURES, contrastThreshold=CONTRAST, edgeThreshold=10, enable_precise_upscale=True
    )
    keypoints, descriptors = sift.detectAndCompute(np.round(255 * toned(image)).astype(np.uint8), mask)
    if descriptors is None or not len(keypoints):
        return Features(np.zeros((0, 2)), np.zeros((0, 128), np.float32))
    places = np.array([k.pt for k in keypoints]) + 0.5  # OpenCV puts the first pixel's centre at 0
    _, once = np.unique(places, axis=0, return_index=True)  # the same place with several orientations counts once
    once = np.sort(once)
    unit = descriptors[once] / np.maximum(descriptors[once].sum(axis=1, keepdims=True), 1e-12)
    return Features(places[once], np.sqrt(unit, dtype=np.float32))
