"""Edges of a grey image, (H, W) uint8, as thin lines of pixels.

Start with ``edges``: outlines by the response of Harris and Stephens (1988) and by the colours on both sides.
``combined_detector`` finds corners and edges in one pass, as they do; ``detect`` has one call for each.
``edge_kernels`` and ``edge_sides`` measure the strength of an outline. ``edge_tracing`` makes chains of the pixels,
with ``edge_pieces``, ``edge_pixels`` and ``edge_junctions``. ``edge_lines`` makes lines for the page.
"""
