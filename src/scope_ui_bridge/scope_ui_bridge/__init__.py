"""Operator page with live image, clicks and stop, served by aiohttp from a bridge to the graph."""
