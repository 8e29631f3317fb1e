"""Limits for poses that determine the calibration, and rejection of a wrist that did not rotate enough."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from harris_perception.core.hand_eye.degeneracy import DegenerateError
from harris_perception.core.wrist.pose_pairs import some_pairs
from harris_perception.core.wrist.rotation_vectors import rotation_vectors
from icu_common.core.configuration.config import Config, setting
from icu_common.core.geometry.geometry import Transform


@dataclass(frozen=True, slots=True, kw_only=True)
class WristConfig(Config):
    """Limits for poses that determine the calibration."""

    min_turn_rad: float = setting(
        0.17, "Minimum rotation between two poses that counts", minimum=0.001, maximum=3.0, unit="rad"
    )
    min_axes_rad: float = setting(
        0.17, "Minimum angle between the axes of two such rotations", minimum=0.001, maximum=1.5, unit="rad"
    )
    outlier_sigmas: float = setting(
        4.5, "Deviation, in standard deviations, above which a pose is removed", minimum=2.0, maximum=100.0
    )
    max_outliers: float = setting(0.3, "Maximum fraction of poses that may be removed", minimum=0.0, maximum=0.49)
    max_turn_rms_rad: float = setting(
        0.05, "Maximum accepted rms misfit of the rotations", minimum=1e-6, maximum=3.0, unit="rad"
    )
    max_shift_rms_m: float = setting(
        0.02, "Maximum accepted rms misfit of the translations", minimum=1e-6, maximum=10.0, unit="m"
    )


def check_turns(base_from_gripper: Sequence[Transform], config: WristConfig) -> None:
    """Reject poses that leave a part of the calibration undetermined.

    Raises
    ------
    DegenerateError
        With the motion that would help.
    """
    count = len(base_from_gripper)
    if count < 3:
        raise DegenerateError(f"{count} poses; expected 3: turn the wrist and add one")
    turns = rotation_vectors(np.array([x.rotation.T @ y.rotation for x, y in some_pairs(base_from_gripper)]))
    angles = np.linalg.norm(turns, axis=1)
    need = np.degrees(config.min_turn_rad)
    if angles.max() < config.min_turn_rad:
        raise DegenerateError(
            f"the wrist turned by at most {np.degrees(angles.max()):.1f} degrees; expected {need:.0f}: without turns "
            "the camera's place does not show; turn it about two different axes"
        )
    axes = turns[angles >= config.min_turn_rad] / angles[angles >= config.min_turn_rad, None]
    # The second largest singular value of unit axes is the sine of their spread about the main axis.
    main = np.linalg.svd(axes, full_matrices=False)[2][0]
    spread = float(np.arcsin(min(1.0, np.linalg.norm(np.cross(axes, main), axis=1).max())))
    if spread < config.min_axes_rad:
        across = np.eye(3)[int(np.argmin(np.abs(main)))]
        raise DegenerateError(
            f"all turns are about one axis, ({main[0]:.2f}, {main[1]:.2f}, {main[2]:.2f}) of the gripper, to within "
            f"{np.degrees(spread):.1f} degrees: the camera's place along it does not show; turn the wrist by "
            f"{need:.0f} degrees or more about ({across[0]:.0f}, {across[1]:.0f}, {across[2]:.0f}) too"
        )
