"""The machine as a state machine: start reading at ``machine``; each of its parts is a class above the previous one.

They are ``connection`` (port, firmware), ``board_settings``, ``stopping`` (stops), ``proof`` (reports compared with the
path), ``streaming`` (goals), and ``machine`` (homing, and the effect of each message of the board). ``attendance``
has the signs of life of a goal's controller, and ``monitor`` the counts for people.
"""
