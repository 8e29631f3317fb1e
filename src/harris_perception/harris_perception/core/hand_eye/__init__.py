"""The transform from the machine's readings to the camera, and its covariance.

Start with ``hand_eye``: a machine that only translates. ``carriage_camera`` is for cameras that ride on the machine.
``hand_eye_config`` has the limits and ``tip_samples`` the sightings. ``degeneracy`` rejects samples that do not
determine the calibration. ``robust_regression`` fits without wrong detections, ``tip_regression`` refines the fit by
pixels, and ``machine_axes`` splits it into rotation, scale and skew. ``backlash`` is measured during the calibration,
``calibration_file`` stores the result, and ``drift`` compares it with later measurements.
"""
