"""A stop that passes the graph by: a datagram from the page's server to the process that owns the port."""
