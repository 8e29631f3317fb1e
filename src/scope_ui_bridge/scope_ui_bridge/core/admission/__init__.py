"""Limits of each client's share of the server: connections, rates, sizes."""
