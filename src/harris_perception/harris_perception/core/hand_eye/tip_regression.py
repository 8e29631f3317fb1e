"""Regression of the tip on the readings, refined jointly by the pixels of both images."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from harris_perception.core.hand_eye.hand_eye_config import HandEyeConfig
from harris_perception.core.hand_eye.robust_regression import Fit, check_left_out, misfit_rms, robust_fit
from harris_perception.core.hand_eye.tip_samples import Sample
from harris_perception.core.pose.reprojection import RayError, pair_pixels, refine_points
from icu_common.core.geometry.camera_model import StereoModel
from icu_common.core.geometry.geometry import Array


def fit_tip(design: Array, samples: Sequence[Sample], places: int, cameras: StereoModel, config: HandEyeConfig) -> Fit:
    """Fit the tip by design (N, P): in closed form without wrong detections, then by all other pixels jointly.

    Parameters
    ----------
    design, samples
        The regression.
    places
        Number of positions in the images at which the tip was seen. The tracker's error at one position, with the same
        light and background, is reduced only by this number.
    cameras
        The pair that measured it.
    config
        Limits.

    Raises
    ------
    DegenerateError
        Like :func:`harris_perception.core.hand_eye.robust_regression.robust_fit`.
    """
    tips = np.array([s.tip for s in samples], dtype=np.float64)
    # Medians: wrong samples are not known yet, and one sample far away would make all seem noisier.
    by_pixel = np.linalg.inv(pair_pixels(np.median(tips, axis=0, keepdims=True), cameras)[1][0])
    shape = by_pixel @ by_pixel.T
    seen, derivative = pair_pixels(tips, cameras)
    told = np.einsum("nij,njk,nik->n", derivative, np.array([s.covariance for s in samples]), derivative) / 3
    expected_px = float(np.sqrt(np.median(told) + config.tip_sigma_px**2))
    fit = robust_fit(design, tips, expected_px**2 * shape, config)
    used, regression = fit.used, fit.regression
    for _ in range(10):
        regression, spread, sigma = refine_points(design[used], tips[used], regression, cameras)
        off = seen - pair_pixels(design @ regression, cameras)[0]
        again = np.linalg.norm(off, axis=1) <= config.outlier_sigmas * max(sigma, expected_px)
        if (again == used).all():
            break
        used = again
        check_left_out(used, config)
    # Stereo depth depends on the difference of both images' errors, so a shared error does not affect it.
    shared = max(sigma, config.tip_sigma_px)
    far = float(np.mean(tips[used, 2]))
    pixel_m = far / cameras.focal_px
    return dataclasses.replace(
        fit,
        used=used,
        regression=regression,
        spread=spread,
        sigma_px=sigma,
        rms_m=misfit_rms(design[used], tips[used], regression),
        common=RayError(
            eye=np.array([0.5 * cameras.baseline, 0.0, 0.0]),
            across_m=float(np.hypot(config.common_error, config.place_error * np.sqrt(0.5 / places)))
            * shared
            * pixel_m,
            along_m=config.place_error * float(np.sqrt(2.0 / places)) * shared * pixel_m * far / cameras.baseline,
        ),
        variance_factor=(sigma / expected_px) ** 2,
    )
