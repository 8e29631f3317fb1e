"""Colour of cameras that send it at a lower resolution than the image: detecting it, and measuring the ball in it.

This package is pure, like core.
"""
