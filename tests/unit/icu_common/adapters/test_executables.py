"""Where programs of the workspace are looked for."""

from __future__ import annotations

from pathlib import Path

import pytest

from icu_common.adapters.executables import find_executable


def test_an_executable_that_is_not_there_says_where_it_was_looked_for(tmp_path: Path) -> None:
    near = tmp_path / "install" / "icu_bringup" / "lib" / "icu_bringup" / "bring_up"
    with pytest.raises(FileNotFoundError, match=r"camera is not built; tried .*lib/harris_perception/camera"):
        find_executable("harris_perception", "camera", near)
    there = tmp_path / "install" / "harris_perception" / "lib" / "harris_perception" / "camera"
    there.parent.mkdir(parents=True)
    there.touch(mode=0o755)
    assert find_executable("harris_perception", "camera", near) == there


def test_a_workspace_whose_packages_have_one_prefix_needs_no_sourcing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As by ``colcon build --merge-install``, and in /opt/ros."""
    monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)
    near = tmp_path / "install" / "lib" / "scope_ui_bridge" / "ui_bridge"
    there = tmp_path / "install" / "lib" / "icu_bringup" / "bag_record"
    there.parent.mkdir(parents=True)
    there.touch(mode=0o755)
    assert find_executable("icu_bringup", "bag_record", near) == there
