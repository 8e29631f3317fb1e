"""Settings, declared once (``config``), and texts from outside, limited before they are parsed.

``parameter_file`` and ``yaml_text`` read files; ``text_bounds`` and ``option_bounds`` check the limits.
"""
