"""Points in metres from a calibrated pair of images.

``rectifier`` rectifies images. ``stereo_matching`` matches corners along rectified rows and reports each disparity's
standard deviation. It compares windows (``match_windows``), rates the result (``match_rating``) and returns
``matches``, which have points in metres; its loops are in ``stereo_kernels``. ``dense_stereo`` measures every pixel;
``depth_range`` has the limits of both. ``plane_fit`` fits the panel's plane. ``pairing`` pairs the left and right
messages of one instant.
"""
