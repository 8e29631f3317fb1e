"""Plain English, checked: sentences of documents, docstrings and comments against the rules of ``rules.toml``."""
