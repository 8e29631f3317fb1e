"""Simulated bench: instrument panel, room, stereo camera, mechanics and touch."""
