"""Settings of the driver: ``machine_config`` has all of them, ``envelope_config`` those of the space at the panel.

``clearance`` computes from them the height at which a damaged approach still stops above the panel.
"""
