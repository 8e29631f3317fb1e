"""Contact of the stylus: its evidence, and the travel of a press.

``switch`` is the evidence of a switch in the stylus, ``lag`` that of the ball, which lags behind its drive. ``press``
has the travel after the contact, ``heights`` and ``memory`` have the heights of earlier contacts, and ``config`` the
settings.
"""
