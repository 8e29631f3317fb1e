"""Description and display of the start: the graph (``graph_description``), texts and layout of the terminal
(``run_words``, ``terminal_layout``), and the address as a picture (``qr_code``).
"""
