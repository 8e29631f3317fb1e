"""Bag files: one reader and one writer for all forms (``bags``), readers of foreign bags, repair, sink and images."""
