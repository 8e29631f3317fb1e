"""Paths of the installed programs of the workspace's packages."""

from __future__ import annotations

import os
from pathlib import Path


def find_executable(package: str, executable: str, near: Path) -> Path:
    """Return the path of a package's executable.

    The search covers the prefixes that ament lists and those next to ``near``, an executable of the same workspace, so
    nothing needs to be sourced. In a workspace each package has its own prefix, or all packages share one
    (``colcon build --merge-install``).

    Raises
    ------
    FileNotFoundError
        With the paths that were tried.
    """
    own = near.resolve().parents
    prefixes = [Path(p) for p in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if p]
    # The prefix in PREFIX/lib/PACKAGE/EXECUTABLE.
    beside = [own[3] / package, own[3], own[2]] if len(own) > 3 else []
    tried = []
    for prefix in (*beside, *prefixes):
        path = prefix / "lib" / package / executable
        if path.is_file() and os.access(path, os.X_OK):
            return path
        tried.append(str(path))
    raise FileNotFoundError(f"{package}/{executable} is not built; tried {', '.join(tried)}; run: scripts/setup.sh")
