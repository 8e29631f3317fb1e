"""Parts of nodes that compare the cameras with each other and the panel with its layout."""
