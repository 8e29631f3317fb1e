"""Paths of the stylus: the points to touch (``targets``), panel and bench (``scene``), and the path (``motion_plan``).

``touch_error`` is the uncertainty of a touch.
"""
