"""Simulated bench (instrument panel, stereo camera, mechanics, touch) and bring-up of the whole graph."""
