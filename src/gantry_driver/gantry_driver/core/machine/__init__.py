"""The machine as a state machine: start reading at ``machine``; its parts are ``stopping`` and ``streaming``.

``machine_states`` has the states and events, ``machine_config`` the settings, ``stylus_state`` the state of the
stylus, and ``monitor`` the counts for people.
"""
