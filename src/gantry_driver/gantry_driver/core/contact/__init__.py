"""Contact of the stylus: its evidence, and the travel of a press."""
