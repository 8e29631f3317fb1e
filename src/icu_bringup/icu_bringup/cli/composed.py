"""Run the nodes of several programs in one process; bring_up --composed writes the table and starts this."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from importlib.metadata import entry_points
from pathlib import Path

from icu_common.adapters.processes.program_end import ends_quietly
from icu_common.nodes.runtime import run_together


def program(name: str) -> Callable[[], int]:
    """Return the ``main`` of an installed executable.

    Raises
    ------
    LookupError
        If no package installs an executable of this name.
    """
    for entry in entry_points(group="console_scripts", name=name):
        return entry.load()  # type: ignore[no-any-return]
    raise LookupError(f"no package installs {name}; run: scripts/setup.sh")


@ends_quietly
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(prog="composed", description=__doc__)
    parser.add_argument("table", type=Path, help="JSON: pairs of an executable's name and its ROS arguments")
    path = parser.parse_args(arguments).table
    try:
        programs = [(program(name), own) for name, own in json.loads(path.read_text(encoding="utf-8"))]
    except (LookupError, OSError, TypeError, ValueError) as error:
        print(f"error: {path}: {error}", file=sys.stderr)
        return 2
    return run_together(programs)


if __name__ == "__main__":
    raise SystemExit(main())
