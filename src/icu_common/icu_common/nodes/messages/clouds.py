"""Points with columns as PointCloud2 messages, and back."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header

from icu_common.nodes.messages.cameras import _data
from icu_common.nodes.messages.joints import _shown


def _float_fields(names: Sequence[str]) -> list[PointField]:
    return [PointField(name=name, offset=4 * i, datatype=PointField.FLOAT32, count=1) for i, name in enumerate(names)]


def cloud_message(columns: Sequence[str], values: npt.ArrayLike, head: Header) -> PointCloud2:
    """Pack (N, len(columns)) float32 values as an unorganised cloud with these field names."""
    rows = np.ascontiguousarray(np.asarray(values, dtype=np.float32).reshape(-1, len(columns)))
    cloud = PointCloud2(header=head, height=1, width=len(rows), fields=_float_fields(columns))
    cloud.is_dense, cloud.point_step = bool(np.isfinite(rows).all()), 4 * len(columns)
    cloud.row_step = cloud.point_step * len(rows)
    cloud.data = _data(rows)
    return cloud


def cloud_array(cloud: PointCloud2, columns: Sequence[str]) -> npt.NDArray[np.float32]:
    """Return (N, len(columns)) float32 of the named FLOAT32 fields.

    Raises
    ------
    ValueError
        If a field is missing or not FLOAT32, the bytes have another order, or the size does not fit the data.
    """
    offsets = {f.name: f.offset for f in cloud.fields if f.datatype == PointField.FLOAT32}
    missing = [name for name in columns if name not in offsets]
    if missing:
        raise ValueError(f"the cloud has no float32 field {', '.join(missing)}; it has {_shown(offsets)}")
    if cloud.is_bigendian:
        raise ValueError("the cloud has its most significant bytes first; expected the other order")
    count, used = cloud.width * cloud.height, cloud.width * cloud.point_step
    # Rows may be padded; a single row need not state its length.
    row = (cloud.row_step or used) if cloud.height > 1 else used
    end = max((offsets[name] + 4 for name in columns), default=0)
    if cloud.point_step < end or row < used or len(cloud.data) < row * cloud.height:
        raise ValueError(
            f"a cloud of {cloud.width} x {cloud.height} points with step {cloud.point_step}, rows of {row} bytes and "
            f"fields up to byte {end} does not fit {len(cloud.data)} bytes"
        )
    rows = np.frombuffer(cloud.data, np.uint8)[: row * cloud.height].reshape(cloud.height, row)
    raw = rows[:, :used].reshape(count, cloud.point_step)
    parts = [np.ascontiguousarray(raw[:, offsets[n] : offsets[n] + 4]).view("<f4") for n in columns]
    return np.hstack(parts) if parts else np.empty((count, 0), np.float32)


def organised_cloud_message(xyz_m: npt.NDArray[Any], bgr: npt.NDArray[np.uint8], head: Header) -> PointCloud2:
    """Pack (H, W, 3) points in metres with (H, W, 3) colours, one point for each pixel; unknown points are NaN.

    Colour is the field ``rgb`` as viewers read it: one float32 whose bytes are blue, green, red and zero.
    """
    height, width = xyz_m.shape[:2]
    points = np.zeros((height, width, 4), np.float32)
    colours = points.view(np.uint8).reshape(height, width, 16)
    for i in range(3):  # one by one: numpy copies rows of three values ten times as slowly
        points[:, :, i] = xyz_m[:, :, i]
        colours[:, :, 12 + i] = bgr[:, :, i]
    fields = _float_fields(("x", "y", "z", "rgb"))
    cloud = PointCloud2(header=head, height=height, width=width, fields=fields, point_step=16, row_step=16 * width)
    cloud.is_dense = bool(np.isfinite(points[:, :, 2]).all())
    cloud.data = _data(points)
    return cloud
