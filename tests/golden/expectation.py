"""The golden bag's expectation: `bag_check` replays the bag and compares the results with it."""

from __future__ import annotations

import subprocess
from pathlib import Path

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
BAG, EXPECTED = HERE / "bag", HERE / "expected.yaml"
BAG_CHECK = ROOT / "ros2_ws" / "install" / "icu_bringup" / "lib" / "icu_bringup" / "bag_check"


def bag_check(*arguments: str | Path, within_s: float = 300.0) -> subprocess.CompletedProcess[str]:
    """Run bag_check on the golden bag and its expectation."""
    command = [str(part) for part in (BAG_CHECK, BAG, "--expect", EXPECTED, *arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=within_s, check=False)
