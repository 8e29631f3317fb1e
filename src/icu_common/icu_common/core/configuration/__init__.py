"""Settings, declared once (``config``), and texts from outside, limited before they are parsed.

``parameter_file``, ``yaml_text`` and ``yaml_entries`` read files; ``text_bounds`` and ``option_bounds`` check the
limits.
"""
