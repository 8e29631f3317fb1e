"""The stylus tip in both images: the centre of its ball in metres, with a covariance.

Begin with ``stylus``. ``ball_view`` predicts how the ball looks, ``ball_fit`` fits it to an image, ``still_ball``
measures a ball at rest quickly, and ``tip_record`` keeps where the tip was, so that recognition knows what it hides.
"""
