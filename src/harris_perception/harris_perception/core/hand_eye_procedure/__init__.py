"""The robot's calibration procedure: positions to visit, measurements of the tip, and the end condition.

``calibration_plan`` and ``calibration_tour`` choose the positions, ``still_watch`` and ``calibration_look`` take the
samples, ``pair_corrections`` makes them comparable, and ``calibration_solution`` solves. ``calibration_run`` is the
procedure as a state machine; ``panel_clearance`` keeps it off the panel, and ``lowering_check`` detects a faulty
stylus. ``calibrator`` connects the run to the node's events: ``calibrator_config`` has the settings,
``calibrator_actions`` what it orders, ``conditions`` the cameras and settings for which a calibration is valid, and
``calibration_in_use`` the one that is valid now.
"""
