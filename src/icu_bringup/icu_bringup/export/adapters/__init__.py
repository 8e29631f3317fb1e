"""Parts that read bags and write files."""
