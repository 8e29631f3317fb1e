"""Mechanisms of the simulated machine, each with a size, a source and a switch."""
