"""Shared code of the gantry robot's packages; the only package that the others import.

``core`` is pure (configuration, geometry, cameras, panel layouts, results), ``adapters`` touch sockets and files,
``nodes`` contains all code that needs rclpy (parameters, QoS, message conversions, process start and end).
"""
