"""Monitors the right camera's rotation relative to its calibration, and decides what to do about it.

One pair measures the rotation (yaw and pitch) to about 0.02 px. The remaining error is nearly the same in every pair,
so successive pairs agree within some thousandths of a pixel. A change is therefore visible at once, and averaging
hardly helps. A measurement that differs from the previous ones must repeat before it counts.
"""

from __future__ import annotations

import dataclasses
from collections import deque
from collections.abc import Iterator

import cv2
import numpy as np
import numpy.typing as npt

from harris_perception.core.alignment.pair_config import PairConfig
from harris_perception.core.alignment.pair_rotation import PairRotation, SideView, measure_rotation, turned_right
from harris_perception.core.recognition.face_measurement import FaceMeter
from harris_perception.core.recognition.still_panel import StillPanel
from icu_common.core.alignment.pair import PairCode, PairState
from icu_common.core.geometry.camera_model import CameraModel, StereoModel
from icu_common.core.geometry.geometry import Array, Transform

_BLUR_EVERY = 20
"""Number of measurements between two measurements of each image's blur, which changes slowly."""
_UNCHANGED = 3
"""Maximum number of successive unchanged pairs that are not measured; a change too small to see is found after them."""
Gray = npt.NDArray[np.uint8]


class PairWatch:
    """Measures pairs and stores the rotation that counts.

    Parameters
    ----------
    config
        Limits.
    meter
        Measures the face of the designated panel.
    cameras
        The calibration.
    """

    def __init__(self, config: PairConfig, meter: FaceMeter, cameras: StereoModel) -> None:
        self.config, self._meter, self._cameras = config, meter, cameras
        self._maps = tuple(camera.rectification_maps() for camera in (cameras.left, cameras.right))
        self._agreeing: deque[PairRotation] = deque(maxlen=config.window)
        self._others: deque[PairRotation] = deque(maxlen=config.window)
        self._blur_px = [0.0, 0.0]
        self._looks = 0
        self._still = tuple(StillPanel(meter.layout, _UNCHANGED) for _ in range(2))
        self.views: tuple[Gray, Gray] | None = None
        """Rectified images of the latest measured pair."""
        self.camera_from_panel: Transform | None = None
        self._accepted = np.zeros(3)
        self.state = PairState()
        self.cameras = cameras
        """Calibration corrected by the rotation that counts."""

    def unchanged(self, left: Gray, right: Gray, stamp_ns: int) -> bool:
        """Return whether a pair of raw grey images (H, W) shows the panel as the last measured pair did.

        The state then holds for this pair too, and gets its stamp. While measurements differ or are few, each pair
        counts as changed.
        """
        settled = len(self._agreeing) == self.config.window and not self._others
        if not settled or not all(still.unchanged(gray) for still, gray in zip(self._still, (left, right))):
            return False
        self.state = dataclasses.replace(self.state, stamp_ns=stamp_ns)
        return True

    def look(self, left: Gray, right: Gray, camera_from_panel: Transform, stamp_ns: int) -> bool:
        """Measure one pair of raw grey images; return whether it could be measured.

        Parameters
        ----------
        left, right
            (H, W) uint8, raw.
        camera_from_panel
            Approximate pose of the panel.
        stamp_ns
            Stamp of the pair.
        """
        self.views, self.camera_from_panel = None, None
        images = [
            np.asarray(cv2.remap(gray, *maps, cv2.INTER_LINEAR), np.uint8)
            for gray, maps in zip((left, right), self._maps)
        ]
        try:
            sides = list(self._sides(images, camera_from_panel))
            found = measure_rotation(sides[0], sides[1], camera_from_panel, self._cameras)
        except ValueError:
            return False
        sigma_px = self._cameras.focal_px * np.sqrt(np.diag(found.covariance))
        if not sigma_px[:2].max() <= self.config.max_sigma_px:
            return False
        self.views, self.camera_from_panel = (images[0], images[1]), found.camera_from_panel
        self._take(found)
        self._judge(stamp_ns)
        for side, (gray, camera) in enumerate(zip((left, right), (self._cameras.left, self._cameras.right))):
            self._still[side].measured(gray, self._seen_from(side, found.camera_from_panel), camera)
        return True

    def _sides(self, images: list[Gray], camera_from_panel: Transform) -> Iterator[SideView]:
        self._looks += 1
        for side, (image, camera) in enumerate(zip(images, (self._cameras.left, self._cameras.right))):
            start = self._seen_from(side, camera_from_panel)
            if self._looks % _BLUR_EVERY == 1:
                self._blur_px[side] = self._meter.blur(image, start, camera, self._blur_px[side])
            yield self._side(image, start, camera, self._blur_px[side])

    def _seen_from(self, side: int, camera_from_panel: Transform) -> Transform:
        """Return the pose in one camera's rectified frame, using the last measured rotation."""
        if side == 0:
            return camera_from_panel
        last = self._others or self._agreeing
        rotation = last[-1].rotation_rad if last else np.zeros(3)
        back = np.asarray(cv2.Rodrigues(-rotation)[0], dtype=np.float64)
        shifted = camera_from_panel.translation - np.array([self._cameras.baseline, 0.0, 0.0])
        return Transform(back @ camera_from_panel.rotation, back @ shifted)

    def _side(self, image: Gray, start: Transform, camera: CameraModel, blur_px: float) -> SideView:
        """Measure the print by its edges, or first by its corners, which are found from farther away."""
        measured = self._meter.by_edges(image, start, camera, blur_px)
        if measured is None and (fit := self._meter.by_corners(image, start, camera, blur_px)) is not None:
            measured = self._meter.by_edges(image, fit, camera, blur_px)
        if measured is None:
            raise ValueError("too little of the print is seen")
        return SideView(points=measured[1], line=measured[2])

    def _take(self, found: PairRotation) -> None:
        if self._agreeing and self._near(found, self._agreeing):
            self._agreeing.append(found)
            self._others.clear()
            return
        if self._others and not self._near(found, self._others):
            self._others.clear()
        self._others.append(found)
        if not self._agreeing or len(self._others) >= self.config.frames:
            self._agreeing, self._others = self._others, self._agreeing
            self._others.clear()

    def _near(self, found: PairRotation, kept: deque[PairRotation]) -> bool:
        off_px = self._cameras.focal_px * np.abs(found.rotation_rad - _mean(kept))
        return bool(off_px[:2].max() <= self.config.jump_px)

    def accept(self) -> None:
        """Accept the present rotation as that of a new calibration, which was made with the corrected rotation."""
        if self.state.known:
            self._accepted = self.state.rotation_rad
            self._judge(self.state.stamp_ns)

    def _judge(self, stamp_ns: int) -> None:
        rotation = _mean(self._agreeing)
        covariance = np.asarray(np.mean([found.covariance for found in self._agreeing], axis=0))
        turn_deg = float(np.degrees(np.hypot(*(rotation - self._accepted)[:2])))
        config, code = self.config, PairCode.ALIGNED
        if self._others or len(self._agreeing) < config.frames:
            code = PairCode.CHANGING
        elif turn_deg > config.max_turn_deg:
            code = PairCode.MOVED
        elif rotation @ np.linalg.solve(covariance, rotation) > 3 * config.significant_sigmas**2:
            code = PairCode.CORRECTED
        self.state = PairState(
            code=code,
            rotation_rad=rotation,
            sigma_rad=np.sqrt(np.diag(covariance)),
            turn_deg=turn_deg,
            limit_deg=config.max_turn_deg,
            focal_px=self._cameras.focal_px,
            baseline_m=self._cameras.baseline,
            stamp_ns=stamp_ns,
        )
        if code is not PairCode.CHANGING:
            # Correct it even beyond the limit: a new calibration must measure the tip at its true position.
            self.cameras = turned_right(self._cameras, rotation)


def _mean(kept: deque[PairRotation]) -> Array:
    return np.asarray(np.mean([found.rotation_rad for found in kept], axis=0))
