"""Corners of a grey image, (H, W) uint8, as positions in pixels with their response.

Start with ``harris``: C. Harris and M. Stephens, A combined corner and edge detector, Alvey Vision Conference 1988. Its
loops are in ``harris_kernels``. ``structure`` has gradients and windows of any size, ``harris_laplace`` selects a scale
for each corner, ``repeatable`` has the corners with the best repeatability, and ``matching`` matches corners of two
images.
"""
