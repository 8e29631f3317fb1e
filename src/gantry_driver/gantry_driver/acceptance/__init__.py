"""The acceptance test of a machine: where it moves, what it measures, and the limits that decide.

``stops`` has the readings that the test visits, and ``touch_points`` the points that it touches. ``axes_fit`` computes
direction, scale, squareness and backlash from the tips that the cameras saw. ``sharpness`` measures the focus of an
image, and ``coverage`` the part of the panel in it. ``limits`` has the limits, ``measured`` what one run has measured,
and ``checks`` compares both. ``plots`` draws, and ``report`` writes HTML and JSON.
"""
