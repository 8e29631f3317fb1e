"""Operator page: live picture, clicks, stop; served by aiohttp from a bridge to the graph."""
