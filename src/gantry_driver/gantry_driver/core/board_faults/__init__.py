"""Reports that cannot be used and resets that nobody asked for: what is wrong with the board, and what to do."""
