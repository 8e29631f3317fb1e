"""The designated instrument in an image: pose of its panel, and states of its lamps, knobs and screens.

Start with ``recognition``, which makes a ``sighting``. ``panel_template`` draws a layout, ``panel_search`` finds it
without prior knowledge, and ``face_measurement`` measures its pose to a fraction of a pixel, with ``face_patches`` and
``edge_alignment``. ``still_panel`` detects that nothing has changed.

``panel_reader`` reads lamps, knobs, screens and hands, with the settings of ``state_config``. It samples the image with
``control_samples``, leaves out what the robot hides (``own_shadow``), and compares screens with earlier images
(``screen_watch``). ``panel_teaching`` makes the layout of a new instrument from one image.
"""
