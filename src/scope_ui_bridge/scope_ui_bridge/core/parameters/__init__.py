"""What the page tells of the parameters of the graph's nodes."""
