"""Log message while machine code is compiled, which takes a minute or more at the very first start."""

from __future__ import annotations

import contextlib
import functools
import threading
from collections.abc import Iterator

from rclpy.node import Node

SAY_AFTER_S = 2.0
"""Seconds before the message; loading code cached by an earlier start takes less."""


@contextlib.contextmanager
def compiling(node: Node | None, say_after_s: float = SAY_AFTER_S) -> Iterator[None]:
    """Log, after ``say_after_s``, that code is being compiled: until then the node neither works nor reacts to Ctrl-C.

    Without a node the text is printed: the server that forks programs has no node.
    """
    # A signal handler cannot interrupt the compiler: llvmlite calls back through ctypes, which drops exceptions.
    text = "compiling for this computer, once: it may take a minute or more, and no Ctrl-C is heard before it is done"
    say = functools.partial(print, flush=True) if node is None else node.get_logger().info
    saying = threading.Timer(say_after_s, say, [text])
    saying.daemon = True
    saying.start()
    try:
        yield
    finally:
        saying.cancel()
