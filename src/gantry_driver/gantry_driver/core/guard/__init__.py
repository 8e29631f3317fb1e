"""Messages between the guard process and the driver's node, and the guard's judgement of the node; pure."""
