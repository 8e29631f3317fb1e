"""Process from which bring_up starts programs: see icu_bringup.adapters.fork_server. Not for direct use."""

from __future__ import annotations

import socket
import sys

from icu_bringup.adapters import fork_server


def main() -> int:
    """Serve bring-up until it ends; in a fork, run the program."""
    link = socket.socket(fileno=int(sys.argv[1]))
    command = fork_server.serve(link, bring_up=int(sys.argv[2]))
    if command is not None:
        fork_server.run_script(command)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
