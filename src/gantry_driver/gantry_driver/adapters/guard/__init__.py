"""The guard process: the port's owner, its socket, and the node's side of it."""
