"""What the guard process and the driver's node say to each other, and how the guard judges the node; pure."""
