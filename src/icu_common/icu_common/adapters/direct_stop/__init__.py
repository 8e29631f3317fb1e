"""A stop that bypasses the graph: a datagram from the page's server to the process that owns the port."""
