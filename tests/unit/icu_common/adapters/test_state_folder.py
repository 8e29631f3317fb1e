"""Where kept files are, for all programs alike."""

from __future__ import annotations

from pathlib import Path

import pytest

from icu_bringup.cli import bring_up
from icu_common.adapters.state_folder import default_state_folder
from scope_ui_bridge.cli import page_admin


@pytest.mark.parametrize(
    ("given", "base"),
    [(None, "home/.local/state"), ("", "home/.local/state"), ("{tmp}/xdg", "xdg"), ("~/xdg", "home/xdg")]
    + [("relative", "home/.local/state")],
)
def test_who_starts_the_page_and_who_keeps_its_passwords_agree_on_the_folder(
    given: str | None, base: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    if given is None:
        monkeypatch.delenv("XDG_STATE_HOME", raising=False)
    else:
        monkeypatch.setenv("XDG_STATE_HOME", given.format(tmp=tmp_path))
    folder = tmp_path / base / "icu_gantry"
    assert default_state_folder() == bring_up.state_folder(None) == folder
    assert default_state_folder("/bed_1/") == bring_up.state_folder(None, "/bed_1/") == folder / "bed_1"
    options = [page_admin.parser().parse_args(words) for words in (["audit"], ["password", "ada"])]
    assert [option.file for option in options] == [folder / "audit.jsonl", folder / "passwords"]
