"""Covariance of the parameters that all views of a calibration share."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from icu_common.core.geometry.geometry import Array


def shared_covariance(blocks: Sequence[tuple[Array, Array]], residual: Array, alike: Sequence[int]) -> Array:
    """Return the covariance of the parameters shared by all views, from each view's derivatives by these and its pose.

    It is ``s^2 (J^T J)^-1`` with the boards' poses eliminated (Schur complement; Triggs et al., "Bundle Adjustment - A
    Modern Synthesis", 2000). The deviations that OpenCV 4 reports for one camera are about 1.45 times as large, because
    it counts corners, and a corner has two residuals.

    Errors of corners in one view are correlated (a bent board, light, a rolling shutter), so ``s^2`` alone is too
    small. The covariance is therefore scaled by the views' actual pull on the shared parameters, relative to that of
    independent corners. Views between which the board was not moved have the same number in ``alike`` and count as one.
    """
    shared = blocks[0][0].shape[1]
    own = [j - j_pose @ np.linalg.lstsq(j_pose, j, rcond=None)[0] for j, j_pose in blocks]
    # Distances and distortion differ by six orders of magnitude: scale to a unit diagonal before inverting.
    scale = 1 / np.sqrt(sum(np.sum(rest**2, axis=0) for rest in own))
    own = [rest * scale for rest in own]
    inverse = np.linalg.inv(sum(rest.T @ rest for rest in own))
    variance = float(np.sum(residual**2)) / (residual.size - shared - 6 * len(blocks))
    parts = np.split(np.ravel(residual), np.cumsum([len(rest) for rest in own])[:-1])
    which = np.unique(alike, return_inverse=True)[1] == np.arange(len(set(alike)))[:, None]
    pulls = which @ np.array([rest.T @ off for rest, off in zip(own, parts, strict=True)])
    shares = np.tensordot(which, np.array([inverse @ rest.T @ rest for rest in own]), 1)
    independent = shared - float(np.einsum("nij,nji->", shares, shares))
    together = float(np.einsum("ni,ij,nj->", pulls, inverse, pulls)) / independent
    return np.asarray(inverse * np.outer(scale, scale) * max(variance, together))
