"""Bag files: readers of foreign bags, and writers of bags in several files."""
