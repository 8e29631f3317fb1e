"""What the packages of the gantry robot share; the only package that the others import.

``core`` is pure (configuration, geometry, cameras, panel layouts, results), ``adapters`` touch sockets and files,
``nodes`` hold what needs rclpy (parameters, QoS, message conversions, the way a process starts and ends).
"""
