"""G-code programs from files: ``gcode_check`` checks them, and follows the path that their lines describe.

``gcode_words`` has the words of a line, and the error with its column. ``arcs`` has the geometry of a G2 or G3,
``polyline`` the path with its feeds, and ``marks`` the ends of the lines along the path.
"""
