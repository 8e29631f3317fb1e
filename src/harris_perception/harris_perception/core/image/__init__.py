"""Operations on arrays of pixels that the other packages share.

Encodings to grey (``gray``), values between pixels and means around them (``sampling``), medians (``medians``), bits
for the loops (``bitmap``, ``lanes``), recursive Gaussian derivatives (``deriche``), the noise of an image (``noise``),
edge-preserving diffusion (``diffusion``), drawings for people (``overlay``), and the compiler (``compiled``: numba).
"""
