"""The designated instrument in an image: pose of its panel, and states of its lamps, knobs and screens.

Start with ``recognition``. ``panel_template`` draws a layout, ``panel_search`` finds it without prior knowledge, and
``face_measurement`` measures its pose to a fraction of a pixel, with ``face_patches`` and ``edge_alignment``.
``still_panel`` detects that nothing has changed. ``panel_state`` reads lamps, knobs, screens and hands, with
``screen_watch``. ``panel_teaching`` makes the layout of a new instrument from one image.
"""
