"""Where the programs of the workspace's packages are installed."""

from __future__ import annotations

import os
from pathlib import Path


def find_executable(package: str, executable: str, near: Path) -> Path:
    """Return the path of a package's executable.

    It is looked for where ament says, and beside ``near``, an executable of the same workspace, so that nothing needs
    to be sourced; in a workspace each package has its own prefix, or all have one (``colcon build --merge-install``).

    Raises
    ------
    FileNotFoundError
        With the places that were tried.
    """
    own = near.resolve().parents
    prefixes = [Path(p) for p in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if p]
    # Of PREFIX/lib/PACKAGE/EXECUTABLE.
    beside = [own[3] / package, own[3], own[2]] if len(own) > 3 else []
    tried = []
    for prefix in (*beside, *prefixes):
        path = prefix / "lib" / package / executable
        if path.is_file() and os.access(path, os.X_OK):
            return path
        tried.append(str(path))
    raise FileNotFoundError(f"{package}/{executable} is not built; tried {', '.join(tried)}; run: scripts/setup.sh")
