"""Detects, on the panel, motion of cameras and controls since the calibration.

``pair_watch`` compares both cameras with each other by the panel's print (``pair_rotation``). ``layout_watch`` compares
each control's position with the layout (``control_outlines``). ``pair_config`` and ``layout_config`` are their
settings.
"""
