"""Pure: values in, values out; no rclpy, serial, clock or threads. A map, in an order for reading:

Corners
    ``harris`` (begin here: the detector and its settings), ``harris_kernels`` (its loops, and why they are fast),
    ``structure`` (gradients and window of any size), ``deriche`` (the same by recursion), ``harris_laplace`` (over
    scales), ``repeatable`` with ``noise`` and ``diffusion`` (those that repeat best), ``matching`` (two pictures).
Edges
    ``edges`` (both ways to edges), ``edge_kernels`` and ``edge_sides`` (how strong an outline is), ``edge_tracing``
    (from pixels to chains) with ``edge_pieces``, ``edge_pixels`` and ``edge_junctions``, ``edge_lines`` (for the page).
Stereo
    ``depth_range``, ``stereo_matching`` with ``stereo_kernels`` (few points, each with its error), ``dense_stereo``
    (every pixel), ``plane_fit`` (the panel's plane).
Panel
    ``panel_template`` (what a layout looks like), ``panel_search`` (found from nothing), ``recognition`` (begin here),
    ``face_measurement`` with ``face_patches`` and ``edge_alignment`` (its pose to a fraction of a pixel),
    ``planar_pose``, ``pose_agreement``, ``still_panel`` (nothing new to measure), ``fiducials`` and ``face_depth``
    (second opinions), ``panel_state`` (lamps, knobs, screens, hands) with ``tip_record`` (what the stylus hides),
    ``panel_teaching`` (a new one).
Stylus and hand-eye
    ``stylus`` with ``ball_view`` and ``ball_fit`` (the tip in both pictures), ``still_ball`` (a tip at rest),
    ``hand_eye`` (begin here: a machine that only translates), ``reprojection`` (its last step, in pixels),
    ``backlash``, ``carriage_camera`` (cameras that ride along), ``wrist_camera`` (arms whose wrist turns: AX = XB).
    The procedure: ``calibration_plan``, ``calibration_tour``, ``calibration_look``, ``still_watch``,
    ``calibration_run``, ``calibration_solution``, ``calibrator``, ``drift``, ``calibration_file``. Cameras ``board``
    and ``board_detection``, ``view_coverage`` and ``view_collection``, ``camera_calibration``. Measured against
    others ``repeatability``, ``boundary_evaluation``, ``stereo_evaluation``. Used by all ``gray`` (encodings),
    ``medians``, ``sampling`` (between pixels), ``bitmap`` and ``lanes`` (bits for the loops), ``compiled`` (numba),
    ``pairing`` (messages of one moment), ``overlay`` (drawn for people).
"""
