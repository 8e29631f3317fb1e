"""G-code programs from files: ``gcode_check`` checks them, and follows the path that their lines describe.

``arcs`` has the geometry of a G2 or G3, ``polyline`` the path with its feeds, and ``marks`` the ends of the lines along
the path.
"""
