"""Pure: values in, values out; no rclpy, serial, clock or threads.

Subpackages in reading order, each with a map of its modules: ``image``, ``corners`` (start here), ``edges``,
``stereo``, ``pose``, ``recognition``, ``alignment``, ``stylus``, ``hand_eye``, ``hand_eye_procedure``, ``wrist``,
``cameras``, ``evaluation``. A subpackage imports only subpackages before it.
"""
