"""Camera calibration by a printed board (Z. Zhang, PAMI 2000): matrix, distortion and the pair's geometry.

``print_page`` draws in true size, ``board`` and ``marker_sheet`` what is printed. ``board_detection`` finds the board,
``view_coverage`` and ``view_collection`` select different views, and
``view_requirements`` rejects views that give no calibration. ``camera_calibration`` solves for one camera and
``pair_calibration`` for two, with the settings in ``calibration_config``. ``view_errors`` removes outliers,
``pair_bundle`` and ``shared_covariance`` give the standard deviations, and ``residual_picture`` draws the errors.
"""
