"""Structure from motion on one image a camera: SIFT, matching, verification, mapping, robust adjustment.

The rig that is given lends its focal length as a start and its centres for frame and scale; its poses are not used.
When to use it: scenes with texture, no trust in the nominal poses. Periodic or flat scenes may end in a wrong minimum
with an innocent residual. Source: Schonberger & Frahm, "Structure-from-motion revisited", CVPR 2016, by pycolmap.
"""

import signal
import tempfile
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from acquisition.progress import Progress, silent
from reconstruction.errors import BadRunError, GeometryError
from reconstruction.initialization.geometry import (
    FEWEST_VIEWS,
    Geometry,
    Images,
    first_of_one_size,
    laid_on,
    toned,
    usable_views,
)
from rigs.camera import Camera
from rigs.rig import Rig
from rigs.transform import Transform

Focal = Literal["estimated", "rig"]
SEED = 0
QUIET = 2  # level of COLMAP's log: errors and worse
CAUCHY_PX = 0.25  # scale of the loss in the last adjustment
MOST_ERROR_PX = 2.0  # most reprojection error of a point
LEAST_ANGLE_DEG = 1.0  # least angle between the rays to a point


def sfm(rig: Rig, images: Images, progress: Progress = silent, *, focal: Focal = "estimated") -> Geometry:
    """Return poses, one shared focal length and points from `images`: camera id to [H, W], linear, spikes per tick.

    `focal`: one factor for all, or the rig's. A point's confidence is the number of views that see it. The same input
    gives the same result. Raises BadRunError for images that do not fit the rig and GeometryError, by name, for views
    that could not be placed.
    """
    views = usable_views(rig, images)
    lens = _shared_lens(rig.only(views))
    with tempfile.TemporaryDirectory(prefix="spike4dgs-sfm-") as folder, _quiet_pycolmap() as pycolmap:
        _write_images(Path(folder), rig, lens, toned({c: images[c] for c in views}))
        models = _Run(pycolmap, Path(folder), focal == "estimated", progress).models(lens)
        return _geometry(rig, views, lens, models, focal)


def _shared_lens(rig: Rig) -> Camera:
    """Return the pinhole that all views are seen through: the mean of the rig's lenses, without their distortion."""
    mean = {name: float(np.mean([getattr(c, name) for c in rig.cameras])) for name in ("fx", "fy", "cx", "cy")}
    first = first_of_one_size(rig.cameras, "structure from motion takes one lens for all cameras")
    return replace(first, **mean, distortion=(0.0, 0.0, 0.0, 0.0), lens_model="opencv")


def _write_images(folder: Path, rig: Rig, lens: Camera, images: Mapping[str, NDArray[np.float32]]) -> None:
    (folder / "images").mkdir()
    for camera_id, image in images.items():
        camera = rig.camera(camera_id)
        if camera.bends or not np.allclose(camera.K, lens.K, rtol=1e-9):
            image = _seen_through(lens, camera, image)
        cv2.imwrite(str(folder / "images" / f"{camera_id}.png"), np.round(255 * image).astype(np.uint8))


def _seen_through(lens: Camera, camera: Camera, image: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return what `camera` took [H, W] as `lens` would have taken it from the same place."""
    rows, columns = np.indices((lens.height, lens.width)).reshape(2, -1) + 0.5
    slopes = lens.slopes(np.stack([columns, rows], axis=1))
    places = camera.lens.bent(slopes) * (camera.fx, camera.fy) + (camera.cx, camera.cy) - 0.5  # OpenCV's first is at 0
    maps = np.nan_to_num(places, nan=-1.0).T.reshape(2, lens.height, lens.width).astype(np.float32)
    seen = cv2.remap(image, maps[0], maps[1], cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    return np.clip(seen, 0, 1).astype(np.float32)


@contextmanager
def _quiet_pycolmap() -> Iterator[ModuleType]:
    """Yield pycolmap without its log on stderr.

    It is loaded after OpenCV: the other way round the process dies on a PNG.
    """
    try:
        import pycolmap
    except ImportError as error:
        raise BadRunError("found no pycolmap", "it for sfm", "pip install 'spike4dgs[reconstruction]'") from error
    handler = signal.getsignal(signal.SIGTERM)
    if handler is not None and threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, handler)  # pycolmap has put its own there, which prints a stack trace
    before = pycolmap.logging.minloglevel
    pycolmap.logging.minloglevel = QUIET
    try:
        yield pycolmap
    finally:
        pycolmap.logging.minloglevel = before


@dataclass(frozen=True)
class _Run:
    """COLMAP's steps in one temporary folder; one thread and one seed, so that they can be repeated."""

    pycolmap: Any
    folder: Path
    free_focal: bool
    progress: Progress

    def models(self, lens: Camera) -> list[Any]:
        """Return the models found, largest first."""
        self.pycolmap.set_random_seed(SEED)
        try:
            self.progress(0.0, "features")
            self._extract(lens)
            self.progress(0.35, "matches")
            self._match()
            self.progress(0.65, "incremental mapping")
            found = sorted(self._map().values(), key=lambda m: (m.num_reg_images(), m.num_points3D()), reverse=True)
            self.progress(0.85, "bundle adjustment")
            self._adjust(found[:1])
        except (RuntimeError, ValueError) as error:
            raise GeometryError(f"found a failure of COLMAP: {str(error).splitlines()[0]}") from error
        self.progress(1.0, "mapped")
        return found

    @property
    def _places(self) -> tuple[Path, Path]:
        return self.folder / "database.db", self.folder / "images"

    def _extract(self, lens: Camera) -> None:
        colmap = self.pycolmap
        even = abs(lens.fx / lens.fy - 1) < 1e-9
        numbers = (lens.fx, lens.cx, lens.cy) if even else (lens.fx, lens.fy, lens.cx, lens.cy)
        reader = colmap.ImageReaderOptions()
        reader.camera_model = "SIMPLE_PINHOLE" if even else "PINHOLE"
        reader.camera_params = ",".join(repr(n) for n in numbers)
        extraction = colmap.FeatureExtractionOptions()
        extraction.num_threads = 1
        how = {"camera_mode": colmap.CameraMode.SINGLE, "device": colmap.Device.cpu}
        colmap.extract_features(*self._places, reader_options=reader, extraction_options=extraction, **how)

    def _match(self) -> None:
        colmap = self.pycolmap
        matching, verification = colmap.FeatureMatchingOptions(), colmap.TwoViewGeometryOptions()
        matching.num_threads = 1
        verification.ransac.random_seed = SEED
        how = {"matching_options": matching, "verification_options": verification, "device": colmap.Device.cpu}
        colmap.match_exhaustive(self._places[0], **how)

    def _map(self) -> Mapping[int, Any]:
        how = self.pycolmap.IncrementalPipelineOptions()
        how.ba_refine_focal_length = self.free_focal
        how.mapper.abs_pose_refine_focal_length = False  # one view alone says too little
        how.min_model_size, how.num_threads, how.random_seed = FEWEST_VIEWS, 1, SEED
        return self.pycolmap.incremental_mapping(*self._places, self.folder / "models", how)

    def _adjust(self, models: list[Any]) -> None:
        """Adjust once more with a loss that forgets what does not fit: without it movers pull by .05 degrees."""
        colmap = self.pycolmap
        how = colmap.BundleAdjustmentOptions()
        how.refine_focal_length = self.free_focal
        how.refine_principal_point = how.refine_extra_params = how.print_summary = False
        how.ceres.use_gpu = False
        how.ceres.solver_options.num_threads = 1
        how.ceres.loss_function_type = colmap.LossFunctionType.CAUCHY
        how.ceres.loss_function_scale = CAUCHY_PX
        for model in models:
            what = colmap.BundleAdjustmentConfig()
            for image_id in model.reg_image_ids():
                what.add_image(image_id)
            what.fix_gauge(colmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
            # bundle_adjustment() logs whatever one asks
            colmap.create_default_bundle_adjuster(how, what, model).solve()
            colmap.ObservationManager(model).filter_all_points3D(MOST_ERROR_PX, LEAST_ANGLE_DEG)
            model.update_point_3d_errors()


def _geometry(rig: Rig, views: tuple[str, ...], lens: Camera, models: list[Any], focal: Focal) -> Geometry:
    """Return the largest model as cameras on the rig and points; raises GeometryError where it lacks a view."""
    images = models[0].images.values() if models else ()
    poses = {image.name.removesuffix(".png"): image.cam_from_world() for image in images}
    absent = [c for c in views if c not in poses]
    if absent:
        advice = "give sharper or less noisy images, or keep the rig's poses"
        raise GeometryError(f"found no place for {', '.join(absent)} of {len(views)} views", "all", advice)
    (colmap_lens,) = models[0].cameras.values()
    x, y = colmap_lens.focal_length_x / lens.fx, colmap_lens.focal_length_y / lens.fy
    cameras = []
    for camera in rig.only(views).cameras:
        pose = poses[camera.id]
        placed = Transform(np.asarray(pose.rotation.matrix()), np.asarray(pose.translation))
        cameras.append(replace(camera, fx=camera.fx * x, fy=camera.fy * y, cam_from_rig=placed))
    estimated, similarity, report = laid_on(rig, replace(rig, cameras=tuple(cameras)))
    points = [(point.xyz, point.track.length()) for _, point in sorted(models[0].points3D.items())]
    report |= {
        "method": "sfm incremental",
        "focal": focal,
        "unregistered": [],
        "models": len(models),
        "points": len(points),
        "reprojection_error_px": float(models[0].compute_mean_reprojection_error()),
    }
    positions = similarity.apply(np.array([xyz for xyz, _ in points]).reshape(-1, 3))
    return Geometry(estimated, positions, np.array([seen for _, seen in points], np.float32), report=report)
