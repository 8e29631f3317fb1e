"""The robot's calibration procedure: positions to visit, measurements of the tip, and the end condition.

``calibration_plan`` and ``calibration_tour`` choose the positions, ``still_watch`` and ``calibration_look`` take the
samples, ``calibration_solution`` solves, ``calibration_run`` is the procedure as a state machine, and ``calibrator``
connects it to the node's events.
"""
