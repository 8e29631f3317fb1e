"""Hand-eye calibration of an arm whose wrist rotates: AX = XB and AX = ZB over any number of poses.

Start with ``wrist_camera``: it solves, and rejects poses that fit two calibrations. ``wrist_motion`` has the limits and
checks that the wrist rotated enough. ``pose_pairs`` forms pairs of poses, ``closed_forms`` and ``wrist_starts`` give
starts, ``wrist_consensus`` finds the poses that agree, and ``wrist_refinement`` refines both unknowns jointly.
``rotation_vectors`` converts rotations.
"""
