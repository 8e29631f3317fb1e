"""docs/explanation/harris.md: its code is that of the detector, and its numbers are those that the figures show."""

from __future__ import annotations

import re
import runpy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[4]
PAGE = (ROOT / "docs" / "explanation" / "harris.md").read_text()
CORNERS = ROOT / "src" / "harris_perception" / "harris_perception" / "core" / "corners"


@pytest.fixture(scope="module")
def figures() -> dict[str, Any]:
    return runpy.run_path(str(ROOT / "scripts" / "figures" / "harris_figures.py"))


def test_quoted_lines_are_those_of_the_code() -> None:
    lines = {line.strip() for path in CORNERS.glob("*.py") for line in path.read_text().splitlines()}
    quoted = [
        line.strip() for block in re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL) for line in block.splitlines()
    ]
    assert len(quoted) > 12
    assert [line for line in quoted if line not in lines] == []


def test_figures_of_the_page_are_those_that_are_drawn() -> None:
    shown = set(re.findall(r"\]\((harris/\w+\.png)\)", PAGE))
    drawn = set(re.findall(r'folder / "(\w+\.png)"', (ROOT / "scripts/figures/harris_figures.py").read_text()))
    assert shown == {f"harris/{name}" for name in drawn} and len(shown) == 5
    assert all((ROOT / "docs" / "explanation" / name).is_file() for name in shown)


def test_response_is_that_of_the_eigenvalues(figures: dict[str, Any]) -> None:
    """The plane of eigenvalues shows the detector's own response."""
    picture = figures["chart"]()
    large, small = figures["eigenvalues"](picture)
    response = figures["HarrisDetector"](figures["CONFIG"]).response(picture)
    margin = (picture.shape[0] - large.shape[0]) // 2
    inner = response[margin:-margin, margin:-margin]
    expected = large * small - figures["K"] * (large + small) ** 2
    assert np.allclose(inner, expected, atol=1e-4 * float(np.abs(expected).max()))
    ratio = (1 - 2 * 0.04 - np.sqrt(1 - 4 * 0.04)) / (2 * 0.04)
    assert f"{1 / ratio:.0f} times" in PAGE


@pytest.mark.slow
def test_measured_shares_are_those_of_the_page(figures: dict[str, Any]) -> None:
    rows = re.findall(r"^\| (?:rotation|gain|scale|blur) .*\| ([\d, ]+) % \|$", PAGE, re.MULTILINE)
    assert len(rows) == 4
    for (name, measured), told in zip(figures["curves"]().items(), rows):
        shares = [100 * share for _, share in measured]
        assert shares == pytest.approx([float(text) for text in told.split(",")], abs=3.0), name
