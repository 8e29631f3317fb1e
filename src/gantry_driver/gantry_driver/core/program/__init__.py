"""G-code programs from files: the path that their lines describe."""
