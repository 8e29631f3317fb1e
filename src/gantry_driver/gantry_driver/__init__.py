"""GRBL serial driver, gantry controller and mock serial port for an XY stage with a stylus."""
