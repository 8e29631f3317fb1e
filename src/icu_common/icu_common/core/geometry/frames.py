"""Names of frames (REP-105) and joints; their meaning is in docs/reference/frames.md."""

BASE = "base_link"
PANEL = "panel_link"
CAMERA_LEFT = "camera_left_optical_frame"
CAMERA_RIGHT = "camera_right_optical_frame"
READINGS = "gantry_readings"
"""Space of the axis readings: x, y, and minus the extension of the stylus. No transform leads to it."""

JOINT_X = "gantry_x_joint"
JOINT_Y = "gantry_y_joint"
JOINT_STYLUS = "stylus_joint"
JOINTS = (JOINT_X, JOINT_Y, JOINT_STYLUS)
