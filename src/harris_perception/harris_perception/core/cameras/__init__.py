"""Camera calibration by a printed board (Z. Zhang, PAMI 2000): matrix, distortion and the pair's geometry.

``board`` and ``board_detection`` find the board, ``view_coverage`` and ``view_collection`` select different views, and
``camera_calibration`` solves and reports the reprojection error.
"""
