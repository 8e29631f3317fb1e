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

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from harris_perception.core.hand_eye.hand_eye import DegenerateError
from icu_common.core.configuration.config import Config, setting
from icu_common.core.geometry.geometry import Array, Transform, mean_pose, nearest_rotation

METHODS = ("park", "horaud", "daniilidis")
_MAX_PAIRS = 2000
_SUBSETS = 100
"""Number of triples of poses that are tried: if three of ten poses are wrong, a third of the triples is right."""
_TOLD_RAD = 0.3
"""Minimum median rotation that contradicts a calibration rotated by 180 degrees; that calibration is then not tried."""
_RIVAL_RATIO = 4.0
"""Ratio of squared residuals, in units of the first calibration's noise, at which a second calibration is refuted.

In 540 sets of three to six poses whose gripper moved by 0.3 to 3 mm in each direction (noise 0.5 mrad and 0.3 mm), the
wrong calibration had the smaller squares in 20: in one by more than a factor of two, in none by four. A factor of four
in likelihood means odds of 64 to 1 for three poses (six degrees of freedom), and of 4096 to 1 for four.
"""


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


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class WristCamera:
    """A calibration.

    Attributes
    ----------
    gripper_from_camera, base_from_target
        X and Z.
    start
        The closed form at which the refinement started.
    rotation_rms_rad, translation_rms_m
        Misfit of the poses used, per degree of freedom.
    covariance
        (12, 12) of small rotations (rad) and translations (m): X's rotation and translation in its own frame, then Z's.
    used
        (N,) bool, poses used.
    """

    gripper_from_camera: Transform
    base_from_target: Transform
    start: str
    rotation_rms_rad: float
    translation_rms_m: float
    covariance: Array
    used: npt.NDArray[np.bool_]

    def sigmas(self) -> tuple[float, float]:
        """Return the standard deviations of X's rotation (rad) and translation (m), over all axes together."""
        variance = np.diag(self.covariance)
        return float(np.sqrt(variance[:3].sum())), float(np.sqrt(variance[3:6].sum()))


def calibrate_wrist(
    base_from_gripper: Sequence[Transform], camera_from_target: Sequence[Transform], config: WristConfig | None = None
) -> WristCamera:
    """Solve A X B = Z for X and Z; wrong poses are excluded.

    Raises
    ------
    DegenerateError
        For too few poses, a wrist that did not rotate or rotated about one axis only (with the motion that would help),
        too many poses that do not fit, and a too large misfit of the others.
    """
    config = config if config is not None else WristConfig()
    count = len(base_from_gripper)
    if count != len(camera_from_target):
        raise DegenerateError(f"{count} gripper poses and {len(camera_from_target)} target poses do not pair")
    a, b = list(base_from_gripper), list(camera_from_target)
    check_turns(a, config)
    used, more = _consensus(a, b, config)
    for _ in range(10):
        result, rivals = _solve([t for t, u in zip(a, used) if u], [t for t, u in zip(b, used) if u], used, more)
        alike = [result, *rivals]
        more += [(found.start, found.gripper_from_camera, found.base_from_target) for found in alike if rivals]
        # Among solutions that the same poses cannot distinguish, the one that fits more other poses is right.
        again = max((_fitting(a, b, found, config) for found in alike), key=np.count_nonzero)
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


def closed_form(method: str, pairs: Sequence[tuple[Transform, Transform]]) -> Transform:
    """Return gripper_from_camera by one of ``METHODS``, unrefined, from the pairs of ``relative_motions``."""
    if method == "daniilidis":
        return _daniilidis(pairs)
    rotation = _park(pairs) if method == "park" else _horaud(pairs)
    return Transform(rotation, _translation(pairs, rotation))


def check_turns(base_from_gripper: Sequence[Transform], config: WristConfig) -> None:
    """Reject poses that leave a part of the calibration undetermined.

    Raises
    ------
    DegenerateError
        With the motion that would help.
    """
    count = len(base_from_gripper)
    if count < 3:
        raise DegenerateError(f"{count} poses, 3 are needed: turn the wrist and add one")
    turns = _logs(np.array([x.rotation.T @ y.rotation for x, y in _pairs(base_from_gripper)]))
    angles = np.linalg.norm(turns, axis=1)
    need = np.degrees(config.min_turn_rad)
    if angles.max() < config.min_turn_rad:
        raise DegenerateError(
            f"the wrist turned by at most {np.degrees(angles.max()):.1f} degrees, {need:.0f} are needed: without turns "
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


def _pairs(poses: Sequence[Transform]) -> list[tuple[Transform, Transform]]:
    return [(poses[i], poses[j]) for i, j in _some_combinations(len(poses), 2, _MAX_PAIRS)]


def _some_combinations(count: int, size: int, most: int) -> Iterator[list[int]]:
    """Yield at most ``most`` of the combinations of numbers below ``count``, evenly over their order.

    Each is computed from its position in the order: thousands of poses have billions of triples.
    """
    total = math.comb(count, size)
    for place in range(0, total, max(1, -(-total // most))):
        chosen: list[int] = []
        # Number of following combinations; of those that start later there are comb(later numbers, size).
        behind = total - 1 - place
        for left in range(size, 0, -1):
            later = _most_below(behind, left)
            behind -= math.comb(later, left)
            chosen.append(count - 1 - later)
        yield chosen


def _most_below(value: int, size: int) -> int:
    """Return the largest n with comb(n, size) <= value."""
    low, high = 0, size
    while math.comb(high, size) <= value:
        low, high = high, 2 * high
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if math.comb(middle, size) <= value else (low, middle)
    return low


def relative_motions(a: Sequence[Transform], b: Sequence[Transform]) -> list[tuple[Transform, Transform]]:
    """Return pairs A' X = X B': the motions of the gripper and of the camera between two poses.

    ``a`` is base_from_gripper and ``b`` camera_from_target of each pose.
    """
    # A_i X B_i = A_j X B_j, so (A_j^-1 A_i) X = X (B_j B_i^-1).
    return [
        (a_j.inverse() @ a_i, b_j @ b_i.inverse()) for (a_i, a_j), (b_i, b_j) in zip(_pairs(list(a)), _pairs(list(b)))
    ]


def _park(pairs: Sequence[tuple[Transform, Transform]]) -> Array:
    turns_a, turns_b = (_logs(np.array([pair[k].rotation for pair in pairs])) for k in (0, 1))
    return nearest_rotation(turns_a.T @ turns_b)  # (M^T M)^-1/2 M^T of the paper, by singular values


def _horaud(pairs: Sequence[tuple[Transform, Transform]]) -> Array:
    total = np.zeros((4, 4))
    for a, b in pairs:
        difference = _left(_quaternion(a)) - _right(_quaternion(b))
        total += difference.T @ difference
    w, x, y, z = np.linalg.eigh(total)[1][:, 0]
    return Transform.from_quaternion((x, y, z, w), np.zeros(3)).rotation


def _translation(pairs: Sequence[tuple[Transform, Transform]], rotation: Array) -> Array:
    matrix = np.vstack([a.rotation - np.eye(3) for a, _ in pairs])
    right = np.concatenate([rotation @ b.translation - a.translation for a, b in pairs])
    return np.asarray(np.linalg.lstsq(matrix, right, rcond=None)[0])


def _daniilidis(pairs: Sequence[tuple[Transform, Transform]]) -> Transform:
    rows = []
    for a, b in pairs:
        (qa, da), (qb, db) = _dual(a), _dual(b)
        top = np.hstack([(qa - qb)[1:, None], _cross((qa + qb)[1:]), np.zeros((3, 4))])
        low = np.hstack([(da - db)[1:, None], _cross((da + db)[1:]), (qa - qb)[1:, None], _cross((qa + qb)[1:])])
        rows += [top, low]
    # Only the right singular vectors count. The left ones of 2000 pairs would be 12000 x 12000.
    v = np.linalg.svd(np.linalg.qr(np.vstack(rows), mode="r"))[2]
    (u1, v1), (u2, v2) = ((v[k][:4], v[k][4:]) for k in (6, 7))
    # q = l1 u1 + l2 u2 with |q| = 1 and q . d = 0: a quadratic in l1 / l2.
    roots = np.roots([u1 @ v1, u1 @ v2 + u2 @ v1, u2 @ v2]) if abs(u1 @ v1) > 1e-15 else np.zeros(1)
    best, scale = 0.0, 0.0
    for s in roots.real:
        length = float(s * s * (u1 @ u1) + 2 * s * (u1 @ u2) + u2 @ u2)
        if length > scale:
            best, scale = float(s), length
    q = (best * u1 + u2) / np.sqrt(scale)
    d = (best * v1 + v2) / np.sqrt(scale)
    return Transform.from_quaternion((*q[1:], q[0]), 2 * (_right(_conjugate(q)) @ d)[1:])


def _half_turns(pairs: Sequence[tuple[Transform, Transform]]) -> list[Array]:
    """Return the rotations D by 180 degrees (3, 3), in the gripper, that most motions leave open: D X or X.

    A motion's rotation A' distinguishes them by the angle between D^-1 A' D and A'. It is zero for a rotation about D's
    axis v, and for one by 180 degrees about a perpendicular axis.
    """
    turns = np.array([a.rotation for a, _ in pairs])
    # v is a principal axis of such rotations. With unequal weights, no two axes share an eigenvalue by symmetry.
    axes = np.linalg.svd(_logs(turns) * np.arange(1, len(turns) + 1)[:, None], full_matrices=False)[2]
    # D^-1 A' D differs from A' by a rotation of 2 arccos |v . A' v|.
    told = 2 * np.arccos(np.minimum(np.abs(np.einsum("vi,nij,vj->vn", axes, turns, axes)), 1.0))
    return [2 * np.outer(v, v) - np.eye(3) for v in axes[np.median(told, axis=1) < _TOLD_RAD]]


def _turned(
    x: Transform,
    a: Sequence[Transform],
    b: Sequence[Transform],
    pairs: Sequence[tuple[Transform, Transform]],
    halves: Sequence[Array],
) -> list[tuple[Transform, Transform]]:
    """Return X rotated by each of ``halves``, with the matching translation, and Z."""
    xs = [Transform(r, _translation(pairs, r)) for r in (nearest_rotation(half @ x.rotation) for half in halves)]
    return [(x, _mean_target(a, b, x)) for x in xs]


def _start(
    method: str,
    a: Sequence[Transform],
    b: Sequence[Transform],
    pairs: Sequence[tuple[Transform, Transform]],
    halves: Sequence[Array],
) -> tuple[float, Transform, Transform]:
    """Return squares, X and Z of the closed form, or of its rotation by one of ``halves`` with smaller squares."""
    x = closed_form(method, pairs)
    found = [(x, _mean_target(a, b, x)), *_turned(x, a, b, pairs, halves)]
    return min(((_squares(a, b, x, z), x, z) for x, z in found), key=lambda start: start[0])


def _mean_target(a: Sequence[Transform], b: Sequence[Transform], x: Transform) -> Transform:
    return mean_pose([p @ x @ q for p, q in zip(a, b)])


def _squares(a: Sequence[Transform], b: Sequence[Transform], x: Transform, z: Transform) -> float:
    return float(np.sum(_residuals(a, b, x, z) ** 2))


def _solve(
    a: Sequence[Transform],
    b: Sequence[Transform],
    used: npt.NDArray[np.bool_],
    more: Sequence[tuple[str, Transform, Transform]],
) -> tuple[WristCamera, list[WristCamera]]:
    """Refine the best of the closed forms and of ``more``; also return half turns of it that fit as well."""
    pairs = relative_motions(a, b)
    halves = _half_turns(pairs)
    starts = [(*_start(method, a, b, pairs, halves), method) for method in METHODS]
    # If some rotations of 180 degrees measure slightly more and some slightly less, all closed forms may be far off.
    starts += [(_squares(a, b, x, z), x, z, method) for method, x, z in more]
    _, x, z, start = min(starts, key=lambda start: start[0])
    found = [_refined(a, b, x, z, start, used)]
    turned = _turned(found[0][0].gripper_from_camera, a, b, pairs, halves)
    found += [_refined(a, b, x, z, start, used) for x, z in turned]
    # Rotations and translations have no common unit: the product of both counts.
    result, noise = min(found, key=lambda one: float(np.prod(one[1])))
    rivals = []
    for other, _ in found:
        off = result.gripper_from_camera.rotation.T @ other.gripper_from_camera.rotation
        error = _residuals(a, b, other.gripper_from_camera, other.base_from_target).reshape(-1, 2, 3) / noise[:, None]
        # Exclude the result itself, and solutions that the refinement brought back to it: others are at least 90
        # degrees away.
        if np.trace(off) < 1 and float(np.sum(error**2)) < _RIVAL_RATIO * (6 * len(a) - 12):
            rivals.append(other)
    return result, rivals


def _refined(
    a: Sequence[Transform], b: Sequence[Transform], x: Transform, z: Transform, start: str, used: npt.NDArray[np.bool_]
) -> tuple[WristCamera, Array]:
    """Refine X and Z jointly, by Gauss-Newton with weights from the residuals; also return (2,) the noise of both."""
    count = len(a)
    freedom = np.full(2, 3.0 * count - 6.0)  # of rotations, and of translations

    def noise_of(error: Array) -> Array:
        noise = _rms(error, freedom)
        if count == 3:
            noise = lever * np.sqrt(np.mean((noise / lever) ** 2))
        return np.asarray(np.maximum(noise, 1e-12))

    lever = np.array([1.0, np.sqrt(np.mean([q.translation @ q.translation for q in b])) + 1e-9])
    normal = np.eye(12)
    for turn in range(60):
        error = _residuals(a, b, x, z)
        # Rotations and translations have different noise, estimated from the residuals. Some rotations fit three
        # translations exactly, which then seem to be without noise: their noise is set to that of the rotations at the
        # target's distance.
        weight = 1 / noise_of(error) ** 2
        slope = _slopes(a, b, x, z, error).reshape(count, 2, 3, 12)
        parts = weight[:, None, None] * np.einsum("nkis,nkit->kst", slope, slope)
        normal = parts.sum(axis=0)
        pull = np.einsum("k,nkis,nki->s", weight, slope, error.reshape(count, 2, 3))
        step = -np.linalg.solve(normal, pull)
        x, z = _moved(x, step[:6]), _moved(z, step[6:])
        # Each kind loses as many degrees of freedom as unknowns it determines: a few translations fit with any suitable
        # rotation.
        if count > 3:
            freedom = np.maximum(3 * count - np.trace(np.linalg.solve(normal, parts), axis1=1, axis2=2), 1e-3)
        if turn > 2 and np.abs(step).max() < 1e-10:
            break
    error = _residuals(a, b, x, z)
    rotation_rms, translation_rms = _rms(error, freedom)
    result = WristCamera(
        gripper_from_camera=x,
        base_from_target=z,
        start=start,
        rotation_rms_rad=float(rotation_rms),
        translation_rms_m=float(translation_rms),
        covariance=np.asarray(np.linalg.inv(normal)),
        used=used,
    )
    return result, np.maximum(noise_of(error), 1e-9)


def _rms(error: Array, freedom: Array) -> Array:
    """Return (2,) rms rotation (rad) and translation (m) of residuals (6 N,), per degree of freedom (2,)."""
    return np.asarray(np.sqrt(np.sum(error.reshape(-1, 2, 3) ** 2, axis=(0, 2)) / freedom))


def _residuals(a: Sequence[Transform], b: Sequence[Transform], x: Transform, z: Transform) -> Array:
    """Return (6 N,): rotation (rad) and translation (m) from A X B to Z, in the target's frame."""
    turns_a, shifts_a = np.array([p.rotation for p in a]), np.array([p.translation for p in a])
    turns_b, shifts_b = np.array([q.rotation for q in b]), np.array([q.translation for q in b])
    turns = z.rotation.T @ turns_a @ x.rotation @ turns_b
    ends = (turns_a @ x.apply(shifts_b)[:, :, None])[:, :, 0] + shifts_a
    return np.hstack([_logs(turns), (ends - z.translation) @ z.rotation]).ravel()


def _slopes(a: Sequence[Transform], b: Sequence[Transform], x: Transform, z: Transform, error: Array) -> Array:
    size = 1e-6
    columns = []
    for k in range(12):
        step = np.zeros(12)
        step[k] = size
        columns.append((_residuals(a, b, _moved(x, step[:6]), _moved(z, step[6:])) - error) / size)
    return np.column_stack(columns)


def _consensus(
    a: list[Transform], b: list[Transform], config: WristConfig
) -> tuple[npt.NDArray[np.bool_], list[tuple[str, Transform, Transform]]]:
    """Return the poses that agree with the best of many triples, and its method, X and Z.

    A mean would hide wrong poses that agree with one another.

    This is least median of squares, as in ``hand_eye``'s ``_consensus``. Rotations and translations have no common
    unit, so the product of both medians counts.
    """
    best, used = np.inf, np.ones(len(a), dtype=bool)
    found: list[tuple[str, Transform, Transform]] = []
    # Any three poses nearly fit themselves, so the median of five would be one of them, and right poses would stand
    # out.
    keep = (len(a) + 4) // 2
    for triple in _some_combinations(len(a), 3, _SUBSETS):
        some_a, some_b = [a[i] for i in triple], [b[i] for i in triple]
        try:
            check_turns(some_a, config)
        except DegenerateError:
            continue
        pairs = relative_motions(some_a, some_b)
        _, x, z = _start("park", some_a, some_b, pairs, _half_turns(pairs))
        size = _misfit(a, b, x, z)
        middle = np.maximum(np.sort(size, axis=0)[keep - 1], 1e-9)
        if (product := float(np.prod(middle))) < best:
            best, used = product, _near(size, middle * (1 + 5 / max(1, len(a) - 3)), config)
            found = [("park", x, z)]
    return used, found


def _fitting(a: list[Transform], b: list[Transform], result: WristCamera, config: WristConfig) -> npt.NDArray[np.bool_]:
    size = _misfit(a, b, result.gripper_from_camera, result.base_from_target)
    return _near(size, np.median(size, axis=0), config)


def _misfit(a: Sequence[Transform], b: Sequence[Transform], x: Transform, z: Transform) -> Array:
    """Return (N, 2): rotation (rad) and translation (m) between each pose and Z."""
    return np.asarray(np.linalg.norm(_residuals(a, b, x, z).reshape(-1, 2, 3), axis=2))


def _near(size: Array, middle: Array, config: WristConfig) -> npt.NDArray[np.bool_]:
    # The median length of a three-dimensional normal variable is 1.538 times its standard deviation.
    sigma = np.maximum(middle / 1.538, 1e-9)
    return np.asarray((size <= config.outlier_sigmas * 1.5 * sigma).all(axis=1))


def _moved(transform: Transform, step: Array) -> Transform:
    return Transform(
        nearest_rotation(transform.rotation @ _exp(step[:3])), transform.translation + transform.rotation @ step[3:]
    )


def _logs(rotations: Array) -> Array:
    """Return the rotation vectors (N, 3) rad of matrices (N, 3, 3)."""
    r = rotations
    # Four times q q^T of each quaternion x, y, z, w; the row with the largest diagonal is divided by no small number.
    products = np.empty((len(r), 4, 4))
    products[:, :3, :3] = r + r.transpose(0, 2, 1)
    trace = np.trace(r, axis1=1, axis2=2)
    for i in range(3):
        products[:, i, i] += 1 - trace
        j, k = (i + 1) % 3, (i + 2) % 3
        products[:, i, 3] = products[:, 3, i] = r[:, k, j] - r[:, j, k]
    products[:, 3, 3] = 1 + trace
    best = np.argmax(np.diagonal(products, axis1=1, axis2=2), axis=1)
    q = products[np.arange(len(r)), best]
    q *= np.where(q[:, 3:] < 0, -1.0, 1.0) / np.linalg.norm(q, axis=1, keepdims=True)
    sine = np.linalg.norm(q[:, :3], axis=1, keepdims=True)
    return np.asarray(q[:, :3] * np.where(sine > 1e-12, 2 * np.arctan2(sine, q[:, 3:]) / np.maximum(sine, 1e-12), 2.0))


def _exp(vector: Array) -> Array:
    angle = float(np.linalg.norm(vector))
    k = _cross(vector)
    if angle < 1e-12:
        return np.asarray(np.eye(3) + k)
    return np.asarray(np.eye(3) + np.sin(angle) / angle * k + (1 - np.cos(angle)) / angle**2 * (k @ k))


def _cross(v: Array) -> Array:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def _quaternion(transform: Transform) -> Array:
    """Return (4,) w, x, y, z with w >= 0; AX = XB gives A and B the same w, so the signs agree."""
    return np.roll(transform.quaternion(), 1)


def _dual(transform: Transform) -> tuple[Array, Array]:
    q = _quaternion(transform)
    return q, 0.5 * _left(np.array([0.0, *transform.translation])) @ q


def _left(q: Array) -> Array:
    """Return (4, 4) L(q) with L(q) p = q p; quaternions are w, x, y, z."""
    w, x, y, z = q
    return np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])


def _right(q: Array) -> Array:
    """Return (4, 4) R(q) with R(q) p = p q."""
    w, x, y, z = q
    return np.array([[w, -x, -y, -z], [x, w, z, -y], [y, -z, w, x], [z, y, -x, w]])


def _conjugate(q: Array) -> Array:
    return q * (1.0, -1.0, -1.0, -1.0)
