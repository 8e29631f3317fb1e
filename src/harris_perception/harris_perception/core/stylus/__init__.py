"""The stylus tip in both images: the centre of its ball in metres, with a covariance.

Begin with ``stylus``, and its settings in ``stylus_config``. ``ball_candidates`` finds regions of the ball's colour,
and ``ball_measurement`` measures them: ``ball_view`` gives the outline, and ``ball_fit`` fits the ball to it.
``image_windows`` cuts out the parts of the images for both. ``still_ball`` measures a ball at rest quickly, and
``tip_record`` keeps where the tip was, so that recognition knows what it hides.
"""
