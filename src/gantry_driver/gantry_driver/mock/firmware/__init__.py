"""The firmware of the mock board, in layers; each of the first five modules builds on the previous one.

``interrupts``, ``processor`` (power and main loop), ``realtime`` (real-time bytes), ``execution`` (moves, homing,
EEPROM writes) and ``board`` (``$`` commands). ``gcode`` is the parser, ``motion`` the planner and step generator,
``reports`` has the texts, ``states`` the names and numbers.
"""
