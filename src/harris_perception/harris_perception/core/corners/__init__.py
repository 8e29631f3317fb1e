"""Corners of a grey image, (H, W) uint8, as positions in pixels with their response.

Start with ``harris``: C. Harris and M. Stephens, A combined corner and edge detector, Alvey Vision Conference 1988. It
brings an image into range (``value_range``) and searches it in one fused pass (``harris_kernels``, with the peak test
of ``peak_kernels``) or in steps: ``structure_matrix`` sums the products of gradients, with the weights of ``taps`` and
the loops of ``structure``, and ``response_kernels`` computes the response. ``ranking`` sorts the corners, ``spacing``
keeps distances between them.

``harris_laplace`` selects a scale for each corner, ``repeatable`` has the corners with the best repeatability, and
``matching`` matches corners of two images.
"""
