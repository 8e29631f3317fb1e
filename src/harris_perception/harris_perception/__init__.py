"""Harris corners, stereo matching, hand-eye calibration and panel recognition."""
