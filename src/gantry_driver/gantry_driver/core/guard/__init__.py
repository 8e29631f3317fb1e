"""Messages between the guard process and the driver's node, and the guard's judgement of the node; pure.

``messages`` has the frames and values, ``commands`` what the node may order, and ``silence`` judges a process that
sends no sign of life.
"""
