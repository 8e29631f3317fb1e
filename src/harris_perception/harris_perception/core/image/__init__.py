"""Operations on arrays of pixels that the other packages share.

``gray`` converts encodings to grey, ``sampling`` gives values between pixels and means around them, and ``medians``
medians. ``bitmap`` and ``lanes`` hold bits for the loops, and ``deriche`` recursive Gaussian derivatives. ``noise``
measures an image's noise, ``diffusion`` is edge-preserving, ``overlay`` draws for people, and ``compiled`` is the
compiler (numba).
"""
