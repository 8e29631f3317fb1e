"""Passwords: the file, the roles, and that nothing of a password is kept."""

from __future__ import annotations

import unicodedata
from pathlib import Path

import pytest

from scope_ui_bridge.adapters.secret_files import read_users, write_secret
from scope_ui_bridge.core.access import PasswordError, Role, hash_password, matches, new_user, parse_users

pytestmark = pytest.mark.slow

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


NAMES = [
    *("Jürgen Groß", "Ærøskøbing-Ødegård", "Żółć", "Ngọc Ánh", "Nuria d’Ací i Mª", "O'Brien"),
    *("Ελένη", "Юлія", "דנה לוי", "نور الدين", "प्रियंका", "คำแพง", "김민준", "佐々木さくら", "Ada_2.b"),
    "ÄÖÜẞ" * 8,
]


@pytest.mark.parametrize("name", NAMES)
def test_names_are_written_in_the_letters_of_any_language(name: str, tmp_path: Path) -> None:
    path = tmp_path / "passwords"
    for written in (name, unicodedata.normalize("NFD", name)):  # as some keyboards and systems write it
        user = new_user(written, "operator", "a long password", b"x" * 16)
        assert user.name == unicodedata.normalize("NFC", name)
        write_secret(path, unicodedata.normalize("NFD", user.line()))
        assert read_users(path) == {user.name: user}


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("", "name '': 0 characters, 1 to 32 are allowed"),
        ("ä" * 33, f"name {'ä' * 33!r}: 33 characters, 1 to 32 are allowed"),
        ("x" * 5000, f"name {'x' * 40!r}...: 5000 characters, 1 to 32 are allowed"),
        ("1a", "name '1a': begins with U+0031 DIGIT ONE; a letter is needed there"),
        (" ä", "name ' ä': begins with U+0020 SPACE; a letter is needed there"),
        ("\u0301a", "begins with U+0301 COMBINING ACUTE ACCENT"),
        ("Ada ", "name 'Ada ': ends with U+0020 SPACE"),
        ("Ada  L.", "has two spaces in a row"),
        *(
            (f"Ad{c}a", f"has U+{ord(c):04X}")
            for c in (
                *"\0\n\r\t\x1b\x7f\x85\xa0\xad",  # control characters, line ends, spaces that look like others
                *"\u200b\u200c\u200d\u200e\u200f\u202a\u202e\u2028\u2029\u2060\u2066\u2069\u061c\ufeff",
                *"\u034f\u115f\u1160\u17b4\u180b\u3164\ufe0f\uffa0\U000e0100\U000e0041",  # letters and marks of nothing
                *"Ａ𝐀Ⓐﷲ",  # look like others
                *':/\\"<>&;,=%#@*?|`$(){}[]',
                *"\ud800\ue000\u0378",  # half a character, one of a private range, none
            )
        ),
    ],
)
def test_a_name_that_hides_something_is_refused_with_value_and_bound(name: str, why: str) -> None:
    with pytest.raises(PasswordError) as caught:
        new_user(name, "viewer", "a long password", b"x" * 16)
    assert why in str(caught.value)
    assert str(caught.value).isprintable()


def test_one_name_written_in_two_ways_stands_twice() -> None:
    lines = [f"{unicodedata.normalize(form, 'Jürgen')}:viewer:{GOOD}" for form in ("NFC", "NFD")]
    with pytest.raises(PasswordError, match="line 2: name 'Jürgen' stands twice"):
        parse_users(lines)


@pytest.mark.parametrize("password", ["", "short", "x" * 257])
def test_a_password_has_a_length(password: str) -> None:
    with pytest.raises(PasswordError, match="10 to 256"):
        new_user("ada", "viewer", password, b"x" * 16)
