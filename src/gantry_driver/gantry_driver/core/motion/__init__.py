"""Paths of the stylus: the points to touch (``targets``), panel and bench (``scene``), the path (``motion_plan``), and
the correction by a look at the tip (``servo``).
"""
