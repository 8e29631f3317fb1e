"""Images of two cameras that do not expose together: pairing them, and interpolating the tip between them.

This package is pure, like core.
"""
