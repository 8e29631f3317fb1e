"""The transform from the machine's readings to the camera, and its covariance.

Start with ``hand_eye``: a machine that only translates. ``carriage_camera`` is for cameras that ride on the machine,
and ``wrist_camera`` for arms whose wrist rotates (AX = XB). ``backlash`` is measured during the calibration,
``calibration_file`` stores the result, and ``drift`` compares it with later measurements.
"""
