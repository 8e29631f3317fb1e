"""Facts that images prove when the driver's reports prove nothing.

``pair_sight`` has the state of the camera pair, ``layout_sight`` the controls that differ from the layout, and
``stylus_height`` the height of the stylus above the panel.
"""
