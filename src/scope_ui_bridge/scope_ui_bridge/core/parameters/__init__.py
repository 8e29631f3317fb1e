"""The page's reports on the parameters of the graph's nodes."""
