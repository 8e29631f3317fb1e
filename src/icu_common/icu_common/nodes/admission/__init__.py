"""What a node lets in from the graph: how large a message may be, and which programs may send it."""
