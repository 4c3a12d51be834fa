"""Finds where the pixels of a lens that bends look, for the path tracer. Letters: n places."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquisition.errors import AcquisitionError
from acquisition.scenes.realistic.library import drjit, mitsuba
from rigs.camera import Camera

NODES = 2  # a pixel, along its side, whose rays are exact


def slopes(camera: Camera, x: Any, y: Any) -> tuple[Any, Any]:
    """Return the slopes x / z and y / z [n] at which places x, y [n] of a picture look, in px and camera axes.

    Between the nodes they run straight: at 400 pixels and a bend of 10% that errs by up to 4e-4 px.
    """
    mi, dr = mitsuba(), drjit()
    x, y, stride = x * NODES, y * NODES, camera.width * NODES + 1
    column, row = _whole(x, camera.width * NODES), _whole(y, camera.height * NODES)
    first = row * stride + column
    right, down = x - mi.Float(column), y - mi.Float(row)

    def between(values: Any) -> Any:
        a, b, c, d = (dr.gather(mi.Float, values, first + k) for k in (0, 1, stride, stride + 1))
        return (1 - down) * ((1 - right) * a + right * b) + down * ((1 - right) * c + right * d)

    across, along = _tables(camera)
    return between(across), between(along)


def node_slopes(camera: Camera) -> NDArray[np.float64]:
    """Return where the nodes of a camera's picture look [NODES H + 1, NODES W + 1, 2].

    Raises AcquisitionError for a lens that folds inside the picture.
    """
    rows, columns = np.indices((camera.height * NODES + 1, camera.width * NODES + 1)) / NODES
    found = camera.slopes(np.stack([columns.ravel(), rows.ravel()], axis=1)).reshape(*rows.shape, 2)
    if not np.isfinite(found).all():
        raise AcquisitionError("found a lens that folds inside the picture", "one ray a pixel", where=camera.id)
    return found


def _whole(place: Any, size: int) -> Any:
    """Return the node before each place [n]; rounding may have brought one to the last of `size`."""
    mi, dr = mitsuba(), drjit()
    number = mi.UInt32(place)
    return dr.select(number < size, number, size - 1)


@functools.lru_cache(maxsize=32)
def _tables(camera: Camera) -> tuple[Any, Any]:
    """Return both slopes of all nodes, row by row."""
    mi, dr = mitsuba(), drjit()
    zero = dr.opaque(mi.Float, 0)  # a copy: where NumPy's memory begins would enter the code
    found = node_slopes(camera).astype(np.float32)
    across, along = (mi.Float(np.ascontiguousarray(found[..., k]).ravel()) + zero for k in (0, 1))
    dr.eval(across, along)
    return across, along
