"""Drawing of a calibration's residuals."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from harris_perception.core.cameras.camera_calibration import CameraCalibration


def residual_picture(calibration: CameraCalibration) -> Any:
    """Return (H, W, 3) uint8: each corner with its residual, magnified so that 3 rms are a thirtieth of the width."""
    model = calibration.model
    zoom = max(1.0, 1280 / model.width)
    picture = np.full((round(model.height * zoom) + 40, round(model.width * zoom), 3), 255, np.uint8)
    rms = max(calibration.rms_px, 1e-9)
    magnify = max(1.0, float(f"{model.width / 90 / rms:.1g}"))
    bound = 3 * rms
    for at, residual in zip(calibration.at_px, calibration.residual_px):
        start, end = (tuple(round(v * 8) for v in p * zoom) for p in (at, at + magnify * residual))
        colour = (40, 40, 220) if np.hypot(*residual) > bound else (190, 110, 20)
        cv2.line(picture, start, end, colour, 1, cv2.LINE_AA, 3)
        cv2.circle(picture, start, 10, colour, -1, cv2.LINE_AA, 3)
    text = f"{model.name}: rms {calibration.rms_px:.3f} px, residuals x{magnify:g}, red: above three times the rms"
    cv2.putText(picture, text, (10, picture.shape[0] - 12), cv2.FONT_HERSHEY_SIMPLEX, 0.6, (0, 0, 0), 1, cv2.LINE_AA)
    return picture
