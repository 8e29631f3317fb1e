"""The panel as measured in one image."""

from __future__ import annotations

from dataclasses import dataclass

from harris_perception.core.pose.planar_pose import FacePoints, PoseFit
from harris_perception.core.recognition.face_patches import Patches
from icu_common.core.geometry.geometry import Transform


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Sighting:
    """The panel in one image.

    Attributes
    ----------
    camera_from_panel
        Pose in the camera's rectified frame, metres.
    points
        The measured points that fit.
    rms_px
        Rms misfit of these points under the pose.
    deviation_px
        Standard deviation of the image positions of the face's corners under the pose, with independent errors of
        edges.
    tracked
        Tracked from the previous frame, not searched.
    patches
        Agreement of the print, by position on the face.
    fit
        The pose with its covariance.
    """

    camera_from_panel: Transform
    points: FacePoints
    rms_px: float
    deviation_px: float
    tracked: bool
    patches: Patches
    fit: PoseFit

    @property
    def agreement(self) -> float:
        """Share of agreeing patches among the face's textured patches, 0 to 1."""
        return self.patches.agreement
