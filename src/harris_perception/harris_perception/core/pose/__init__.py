"""Rotation and translation of a plane in front of a camera.

``planar_pose`` solves for it from points of a plane, and ``reprojection`` refines it by the reprojection error in
pixels. ``fiducials`` derives it from printed markers, ``face_depth`` compares it with stereo depth, and
``pose_agreement`` accepts a pose when several images agree.
"""
