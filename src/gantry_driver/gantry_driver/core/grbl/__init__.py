"""GRBL's protocol: messages of the board (``grbl_messages``), lines and answers (``session``), start and loss of the
board (``connection``).

``trajectory_gcode`` writes a path as lines, ``trajectory_bytes`` limits a message before it is decoded, ``gcode_check``
checks programs from files, and ``settings_profile`` compares the board's settings.
"""
