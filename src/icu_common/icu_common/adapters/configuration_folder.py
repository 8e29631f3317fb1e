"""Folder of the configuration: the graph's table, parameters, cameras and layouts."""

from __future__ import annotations

import os
import sys
from pathlib import Path


def configuration_folder() -> Path:
    """Return the folder with graph.yaml: $ICU_CONFIG, or :func:`true_configuration` of the installed folder.

    Raises
    ------
    FileNotFoundError
        If there is none, or $ICU_CONFIG has none.
    """
    if named := os.environ.get("ICU_CONFIG"):
        if not Path(named, "graph.yaml").is_file():
            raise FileNotFoundError(f"no graph.yaml in {named}, which ICU_CONFIG names")
        return Path(named).resolve()
    own = Path(sys.argv[0]).resolve()
    shares = [own.parents[2] / "share"] if len(own.parents) > 2 else []
    if len(own.parents) > 3:  # colcon installs each package into a folder of its own
        shares.append(own.parents[3] / "icu_bringup" / "share")
    shares += [Path(p) / "share" for p in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if p]
    places = [share / "icu_bringup" / "config" for share in shares]
    for place in places:
        if (place / "graph.yaml").is_file():
            return true_configuration(place)
    raise FileNotFoundError(
        f"no graph.yaml in {', '.join(map(str, places))}; name its folder with ICU_CONFIG, or --config of bring_up"
    )


def true_configuration(installed: Path) -> Path:
    """Return the folder to which the link of an installed graph.yaml leads, or the installed folder itself.

    ``colcon build --symlink-install`` links each file alone: calibrations and taught layouts would be missing
    in the installed folder until the next build, or lost with it.
    """
    return (installed / "graph.yaml").resolve().parent
