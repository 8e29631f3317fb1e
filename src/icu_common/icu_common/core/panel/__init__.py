"""An instrument's panel: its controls (``panel_layout``), their gestures (``gesture``), their visible state
(``panel_state``), and the strokes of its print (``stroke_font``).
"""
