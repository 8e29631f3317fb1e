"""Passwords: the file, the roles, and that nothing of a password is kept."""

from __future__ import annotations

from pathlib import Path

import pytest

from scope_ui_bridge.adapters.secret_files import read_users, write_secret
from scope_ui_bridge.core.passwords import PasswordError, Role, hash_password, matches, new_user, parse_users

GOOD = hash_password("correct horse", b"0123456789abcdef")


def test_the_hash_is_scrypt_with_its_cost_and_salt_and_knows_its_password() -> None:
    assert GOOD.startswith("scrypt$32768$8$1$" + b"0123456789abcdef".hex())
    assert "correct" not in GOOD
    assert matches("correct horse", GOOD)
    assert not matches("correct horsE", GOOD)
    assert not matches("", GOOD)
    assert hash_password("correct horse", b"0123456789abcdeF") != GOOD


def test_each_role_may_what_those_before_it_may() -> None:
    assert [[a.may(b) for b in Role] for a in Role] == [[True, False, False], [True, True, False], [True, True, True]]


def test_the_file_is_read_back(tmp_path: Path) -> None:
    ada = new_user("Ada L.", "engineer", "a long password", b"x" * 16)
    path = tmp_path / "passwords"
    write_secret(path, f"# who may come in\n\n{ada.line()}")
    assert read_users(path) == {"Ada L.": ada}
    path.chmod(0o640)
    with pytest.raises(PermissionError, match="mode 640; 600 is needed"):
        read_users(path)


@pytest.mark.parametrize(
    ("line", "why"),
    [
        ("ada", "line 2"),
        (f"ada:admin:{GOOD}", "role 'admin' is none of viewer, operator, engineer"),
        (f"1a:viewer:{GOOD}", "name '1a'"),
        ("ada:viewer:plaintext", "scrypt"),
        (f"eve:viewer:{GOOD}", "stands twice"),
        (f"ada:viewer:{GOOD.replace('32768', '99999999')}", "scrypt"),
    ],
)
def test_a_bad_line_is_named(line: str, why: str) -> None:
    with pytest.raises(PasswordError, match=why):
        parse_users([f"eve:viewer:{GOOD}", line])


@pytest.mark.parametrize("password", ["", "short", "x" * 257])
def test_a_password_has_a_length(password: str) -> None:
    with pytest.raises(PasswordError, match="10 to 256"):
        new_user("ada", "viewer", password, b"x" * 16)
