"""Positions and transforms in metres and radians (``geometry``), frame names (``frames``), cameras (``camera_model``),
and printed markers (``fiducial``).
"""
