"""Unusable reports and unrequested resets: the fault of the board, and the remedy."""
