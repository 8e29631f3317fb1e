"""Messages that a node accepts from the graph: their maximum size and their allowed sources."""
