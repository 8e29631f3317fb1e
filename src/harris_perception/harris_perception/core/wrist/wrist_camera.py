"""Hand-eye calibration of an arm whose wrist rotates: AX = XB and AX = ZB, for any number of poses.

With ``base_from_gripper`` A, ``gripper_from_camera`` X, ``camera_from_target`` B and ``base_from_target`` Z,
``A X B = Z`` for every pose. Pairs of poses eliminate Z (AX = XB), for which three closed forms give starts. The best
start is refined over all poses and both unknowns jointly. A fixed camera that sees a target on the gripper is the same
problem with ``gripper_from_base`` in place of A.

If all rotations A' are about one axis v, or by 180 degrees about axes perpendicular to it, then ``A' D = D A'`` for the
rotation D by 180 degrees about v. The rotations then fit X and D X equally well, and noise decides between them. The
translations distinguish the two, so both are tried. If the gripper rotates without translation, they do not, and the
poses are rejected.

Sources: F. Park, B. Martin, "Robot sensor calibration: solving AX = XB on the Euclidean group" (1994); R. Horaud,
F. Dornaika, "Hand-eye calibration" (1995); K. Daniilidis, "Hand-eye calibration using dual quaternions" (1999).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from harris_perception.core.hand_eye.degeneracy import DegenerateError
from harris_perception.core.wrist.closed_forms import METHODS
from harris_perception.core.wrist.pose_pairs import relative_motions
from harris_perception.core.wrist.wrist_consensus import consistent_poses, fitting_poses
from harris_perception.core.wrist.wrist_motion import WristConfig, check_turns
from harris_perception.core.wrist.wrist_refinement import WristCamera, refined, residuals, squared_error
from harris_perception.core.wrist.wrist_starts import best_start, half_turned, half_turns
from icu_common.core.geometry.geometry import Transform

_RIVAL_RATIO = 4.0
"""Ratio of squared residuals, in units of the first calibration's noise, at which a second calibration is refuted.

540 sets of three to six poses had a gripper that moved by 0.3 to 3 mm in each direction (noise 0.5 mrad and 0.3 mm).
The wrong calibration had the smaller squares in 20 of them: in one by more than a factor of two, in none by four. A
factor of four in likelihood means odds of 64 to 1 for three poses (six degrees of freedom), and of 4096 to 1 for four.
"""


def calibrate_wrist(
    base_from_gripper: Sequence[Transform], camera_from_target: Sequence[Transform], config: WristConfig | None = None
) -> WristCamera:
    """Solve A X B = Z for X and Z; wrong poses are excluded.

    Raises
    ------
    DegenerateError
        For too few poses, too many poses that do not fit, or a too large misfit of the others. Also for a wrist that
        did not rotate, or rotated about one axis only; the message names the motion that would help.
    """
    config = config if config is not None else WristConfig()
    count = len(base_from_gripper)
    if count != len(camera_from_target):
        raise DegenerateError(f"{count} gripper poses and {len(camera_from_target)} target poses do not pair")
    a, b = list(base_from_gripper), list(camera_from_target)
    check_turns(a, config)
    used, more = consistent_poses(a, b, config)
    for _ in range(10):
        result, rivals = _solve([t for t, u in zip(a, used) if u], [t for t, u in zip(b, used) if u], used, more)
        alike = [result, *rivals]
        more += [(found.start, found.gripper_from_camera, found.base_from_target) for found in alike if rivals]
        # Among solutions that the same poses cannot distinguish, the one that fits more other poses is right.
        again = max((fitting_poses(a, b, found, config) for found in alike), key=np.count_nonzero)
        left_out = np.flatnonzero(~again)
        if len(left_out) > config.max_outliers * count:
            numbers = ", ".join(str(i + 1) for i in left_out)
            raise DegenerateError(f"{len(left_out)} of {count} poses do not fit the rest (numbers {numbers})")
        if (again == used).all():
            break
        used = again
        check_turns([t for t, u in zip(a, used) if u], config)
    turn, shift = result.rotation_rms_rad, result.translation_rms_m
    if not (turn <= config.max_turn_rms_rad and shift <= config.max_shift_rms_m):
        # Among unrelated poses no outlier stands out.
        raise DegenerateError(
            f"the poses miss one another by {np.degrees(turn):.1f} degrees and {shift * 1e3:.1f} mm rms, "
            f"{np.degrees(config.max_turn_rms_rad):.1f} degrees and {config.max_shift_rms_m * 1e3:.1f} mm are "
            "accepted: check which frame each is given in, that both are of one moment, and that lengths are in metres"
        )
    if rivals:
        rival = rivals[0]
        raise DegenerateError(
            "two calibrations that are turned by 180 degrees against one another fit the poses alike, to "
            f"{np.degrees(turn):.2f} degrees and {shift * 1e3:.2f} mm, and {np.degrees(rival.rotation_rms_rad):.2f} "
            f"degrees and {rival.translation_rms_m * 1e3:.2f} mm rms: all turns are about one axis or by 180 degrees; "
            "add poses that are turned by about 90 degrees or tilted about another axis too, or that are further apart"
        )
    return result


def _solve(
    a: Sequence[Transform],
    b: Sequence[Transform],
    used: npt.NDArray[np.bool_],
    more: Sequence[tuple[str, Transform, Transform]],
) -> tuple[WristCamera, list[WristCamera]]:
    """Refine the best of the closed forms and of ``more``; also return half turns of it that fit as well."""
    pairs = relative_motions(a, b)
    halves = half_turns(pairs)
    starts = [(*best_start(method, a, b, pairs, halves), method) for method in METHODS]
    # If some rotations of 180 degrees measure slightly more and some slightly less, all closed forms may be far off.
    starts += [(squared_error(a, b, x, z), x, z, method) for method, x, z in more]
    _, x, z, start = min(starts, key=lambda start: start[0])
    found = [refined(a, b, x, z, start, used)]
    turned = half_turned(found[0][0].gripper_from_camera, a, b, pairs, halves)
    found += [refined(a, b, x, z, start, used) for x, z in turned]
    # Rotations and translations have no common unit: the product of both counts.
    result, noise = min(found, key=lambda one: float(np.prod(one[1])))
    rivals = []
    for other, _ in found:
        off = result.gripper_from_camera.rotation.T @ other.gripper_from_camera.rotation
        error = residuals(a, b, other.gripper_from_camera, other.base_from_target).reshape(-1, 2, 3) / noise[:, None]
        # Exclude the result itself, and solutions that the refinement brought back to it: others are at least 90
        # degrees away.
        if np.trace(off) < 1 and float(np.sum(error**2)) < _RIVAL_RATIO * (6 * len(a) - 12):
            rivals.append(other)
    return result, rivals
