"""Unusable reports and unrequested resets: the fault of the board, and the remedy.

``reports`` has the reports that cannot be used, ``resets`` the log of resets, and ``kept_place`` checks whether a board
kept its position.
"""
