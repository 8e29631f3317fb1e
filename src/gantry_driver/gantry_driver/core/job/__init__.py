"""A goal of the controller as values, which its parts share.

``controller_messages`` has the events and actions, ``controller_config`` the settings, ``goal_job`` the state of the
goal in progress. ``effects`` evaluates the instrument's reaction, and ``patience`` has the limits of lateness.
"""
