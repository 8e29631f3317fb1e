"""Linear regression of points on readings, without wrong detections: least median of squares, then the inliers."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from harris_perception.core.hand_eye.degeneracy import MisfitError
from harris_perception.core.hand_eye.hand_eye_config import HandEyeConfig
from harris_perception.core.pose.reprojection import RayError
from icu_common.core.geometry.geometry import Array
from icu_common.core.reasons.message import Message

_SUBSETS, _MOST_LISTED = 3000, 200_000


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Fit:
    """A robust linear regression of points on readings.

    Attributes
    ----------
    regression
        (P, 3) columns of the model, point = design @ regression.
    spread
        (3 P, 3 P) m^2, covariance of ``regression``, row by row.
    sigma_px
        Error of the tip in each image, estimated from the residuals; NaN if it was not fitted by pixels.
    common
        Error shared by all samples.
    variance_factor
        Squared residuals over the samples' own predicted covariances (chi-square per degree of freedom).
    rms_m
        Misfit of the samples used.
    used
        (N,) bool, samples used.
    """

    regression: Array
    spread: Array
    sigma_px: float
    common: RayError
    variance_factor: float
    rms_m: float
    used: npt.NDArray[np.bool_]

    def covariance(self, design: Array) -> Array:
        """Return (N, 3, 3) m^2: covariance of the fitted point of each row of ``design`` (N, P)."""
        return self.own_covariance(design) + self.common.covariance(design @ self.regression)

    def own_covariance(self, design: Array) -> Array:
        """Return the same, (N, 3, 3) m^2, without the error that all samples share."""
        count = len(self.regression)
        blocks = self.spread.reshape(count, 3, count, 3)
        return np.asarray(np.einsum("np,nq,piqj->nij", design, design, blocks))


def robust_fit(design: Array, points: Array, shape: Array, config: HandEyeConfig) -> Fit:
    """Fit points (N, 3) by design (N, P), without outliers.

    Parameters
    ----------
    design, points
        The regression.
    shape
        (3, 3) m^2 covariance of every sample up to one factor, which the residuals determine.
    config
        Limits.

    Raises
    ------
    DegenerateError
        If there are too many outliers, or the misfit of the others is too large.
    """
    used = _consistent_samples(design, points, shape, config)
    regression: Array = np.linalg.lstsq(design[used], points[used], rcond=None)[0].astype(np.float64)
    leverage: Array = np.linalg.inv(design[used].T @ design[used]).astype(np.float64)
    residuals = points[used] - design[used] @ regression
    freedom = 3 * (int(used.sum()) - design.shape[1])
    # The residuals determine the size of the covariance (a posteriori variance of unit weight).
    factor = float(np.einsum("ni,ij,nj->", residuals, np.linalg.inv(shape), residuals)) / max(freedom, 1)
    rms = misfit_rms(design[used], points[used], regression)
    if rms > config.max_rms_m:
        raise MisfitError(
            Message(
                "calibration.samples_miss_one_another_rms", rms_mm=rms * 1000.0, max_rms_mm=config.max_rms_m * 1000.0
            )
        )
    return Fit(
        regression=regression,
        spread=np.kron(leverage, shape * factor),
        sigma_px=float("nan"),
        common=RayError(eye=None, across_m=0.0, along_m=0.0),
        variance_factor=factor,
        rms_m=rms,
        used=used,
    )


def misfit_rms(design: Array, points: Array, regression: Array) -> float:
    """Return the rms distance of points (N, 3) m from design (N, P) @ regression (P, 3), per degree of freedom."""
    squared = float(np.sum((points - design @ regression) ** 2))
    return float(np.sqrt(3.0 * squared / max(points.size - regression.size, 1)))


def _consistent_samples(design: Array, tips: Array, shape: Array, config: HandEyeConfig) -> npt.NDArray[np.bool_]:
    """Return the consistent samples: least median of squares over small subsets, then re-fitted inliers."""
    count, unknown = design.shape
    whiten = np.linalg.cholesky(np.linalg.inv(shape))
    flat = tips @ whiten
    subsets = _subsets(count, unknown)
    matrices = design[subsets]
    sound = np.abs(np.linalg.det(matrices)) > 1e-3 * np.abs(np.linalg.det(matrices)).max()
    models = np.linalg.solve(matrices[sound], flat[subsets[sound]])
    squares = np.sum((flat[None] - design @ models) ** 2, axis=2)
    keep = (count + unknown + 1) // 2
    best = int(np.argmin(np.sort(squares, axis=1)[:, keep - 1]))
    # 2.366 is the median of chi-square with three degrees of freedom; the factor in n is the usual small-sample one.
    scale = np.sqrt(np.sort(squares[best])[keep - 1] / 2.366) * (1 + 5 / max(1, count - unknown))
    used = np.sqrt(squares[best]) <= config.outlier_sigmas * max(scale, 1.0)
    for _ in range(10):
        fitted, *_ = np.linalg.lstsq(design[used], flat[used], rcond=None)
        distances = np.sqrt(np.sum((flat - design @ fitted) ** 2, axis=1))
        freedom = max(1, 3 * (int(used.sum()) - unknown))
        sigma = max(1.0, float(np.sqrt(np.sum(distances[used] ** 2) / freedom)))
        again = distances <= config.outlier_sigmas * sigma
        if (again == used).all():
            break
        used = again
    check_left_out(used, config)
    return np.asarray(used)


def _subsets(count: int, size: int) -> npt.NDArray[np.intp]:
    """Return elemental subsets (M, size) of ``count`` samples: all, an even selection, or random ones of many.

    See Rousseeuw, Leroy, "Robust Regression and Outlier Detection". The first subsets in order all contain the first
    sample; if that is wrong, so are all their models.
    """
    if math.comb(count, size) > _MOST_LISTED:
        chance = np.random.default_rng(0).random((_SUBSETS, count))
        return np.argsort(chance, axis=1)[:, :size]
    subsets = np.array(list(itertools.combinations(range(count), size)))
    return subsets[:: max(1, len(subsets) // _SUBSETS)]


def check_left_out(used: npt.NDArray[np.bool_], config: HandEyeConfig) -> None:
    """Reject a fit that leaves out too many samples.

    Raises
    ------
    MisfitError
        With the numbers of the samples left out.
    """
    left_out = np.flatnonzero(~used)
    if len(left_out) > config.max_outliers * len(used) or int(used.sum()) < config.min_samples:
        numbers = ", ".join(str(i + 1) for i in left_out)
        raise MisfitError(
            Message("calibration.samples_not_fit_rest_numbers", left_out=len(left_out), used=len(used), numbers=numbers)
        )
