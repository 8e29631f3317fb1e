"""What a node says while its machine code is compiled, which takes a minute or more at the very first start."""

from __future__ import annotations

import contextlib
import functools
import threading
from collections.abc import Iterator

from rclpy.node import Node

SAY_AFTER_S = 2.0
"""Code that is only loaded, from where an earlier start has kept it, is there sooner."""


@contextlib.contextmanager
def compiling(node: Node | None, say_after_s: float = SAY_AFTER_S) -> Iterator[None]:
    """Log after a while that code is compiled: until it is, the node neither works nor hears Ctrl-C.

    Without a node the text is printed: the server that forks programs has none.
    """
    # A signal could not interrupt it: llvmlite calls back through ctypes, which drops what a handler raises.
    text = "compiling for this computer, once: it may take a minute or more, and no Ctrl-C is heard before it is done"
    say = functools.partial(print, flush=True) if node is None else node.get_logger().info
    saying = threading.Timer(say_after_s, say, [text])
    saying.daemon = True
    saying.start()
    try:
        yield
    finally:
        saying.cancel()
