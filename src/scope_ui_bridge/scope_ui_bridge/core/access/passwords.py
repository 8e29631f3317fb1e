"""Names, roles and hashed passwords: one line each, ``name:role:scrypt$N$r$p$salt$hash`` (RFC 7914, hexadecimal).

A name has letters of any language, composed (NFC), and no character that is invisible or looks like another one.

scrypt costs 32 MiB and about 0.1 s for each guess; it is part of Python, so nothing has to be installed.
"""

from __future__ import annotations

import enum
import hashlib
import hmac
import re
import unicodedata
from collections.abc import Iterable
from dataclasses import dataclass

_COST, _BLOCK, _PARALLEL = 2**15, 8, 1
_MAX_MEMORY = 64 * 2**20
MIN_PASSWORD, MAX_PASSWORD = 10, 256
MAX_NAME = 32
_BESIDE_LETTERS = " .-_'’"
_SHOWN = 40
# Invisible letters and marks (Default_Ignorable_Code_Point of Unicode).
_UNSEEN = re.compile("[\u034f\u115f\u1160\u17b4\u17b5\u180b-\u180f\u3164\ufe00-\ufe0f\uffa0\U000e0000-\U000e0fff]")


class Role(enum.Enum):
    """Role of a user; each role includes the ones before it. Every role may stop."""

    VIEWER = "viewer"
    OPERATOR = "operator"
    ENGINEER = "engineer"

    def may(self, needed: Role) -> bool:
        """Return whether this role includes ``needed``."""
        order = list(Role)
        return order.index(self) >= order.index(needed)


class PasswordError(ValueError):
    """Invalid line of the file, name or password; the message has the value and the rule."""


@dataclass(frozen=True, slots=True, kw_only=True)
class User:
    """One line of the file."""

    name: str
    role: Role
    hashed: str

    def line(self) -> str:
        """Return the line, without its end."""
        return f"{self.name}:{self.role.value}:{self.hashed}"


def hash_password(password: str, salt: bytes) -> str:
    """Return the hash of a new password; ``salt`` is 16 random bytes.

    Raises
    ------
    PasswordError
        If the password is too short or too long.
    """
    if not MIN_PASSWORD <= len(password) <= MAX_PASSWORD:
        raise PasswordError(f"a password of {len(password)} characters; expected {MIN_PASSWORD} to {MAX_PASSWORD}")
    return f"scrypt${_COST}${_BLOCK}${_PARALLEL}${salt.hex()}${_scrypt(password, salt, _COST, _BLOCK, _PARALLEL).hex()}"


def matches(password: str, hashed: str) -> bool:
    """Return whether a password belongs to a hash; a wrong one takes as long as the right one."""
    _, cost, block, parallel, salt, digest = hashed.split("$")
    found = _scrypt(password[:MAX_PASSWORD], bytes.fromhex(salt), int(cost), int(block), int(parallel))
    return hmac.compare_digest(found, bytes.fromhex(digest))


def new_user(name: str, role: str, password: str, salt: bytes) -> User:
    """Return a user with the hashed password; checks name, role and password."""
    return User(name=checked_name(name), role=_role(role), hashed=hash_password(password, salt))


def parse_users(lines: Iterable[str]) -> dict[str, User]:
    """Return the users of the file's lines; empty lines and lines that begin with # are skipped.

    Raises
    ------
    PasswordError
        With the number of the invalid line.
    """
    users: dict[str, User] = {}
    for number, line in enumerate(lines, 1):
        text = line.strip()
        if not text or text.startswith("#"):
            continue
        try:
            name, role, hashed = text.split(":")
            name = checked_name(name)
            if name in users:
                raise PasswordError(f"name {name!r} stands twice")
            users[name] = User(name=name, role=_role(role), hashed=_checked(hashed))
        except ValueError as error:
            raise PasswordError(f"line {number}: {error}") from error
    return users


def composed(name: str) -> str:
    """Return a name with composed letters, as it is stored and compared; keyboards and systems compose differently."""
    return unicodedata.normalize("NFC", name)


def checked_name(name: str) -> str:
    """Return a name, composed.

    Raises
    ------
    PasswordError
        With the name, what is not allowed in it, and the rule.
    """
    name = composed(name)
    wrong = _wrong_in(name)
    if wrong:
        raise PasswordError(f"name {name[:_SHOWN]!r}{'...' if len(name) > _SHOWN else ''}: {wrong}")
    return name


def _wrong_in(name: str) -> str:
    if not 0 < len(name) <= MAX_NAME:
        return f"{len(name)} characters, 1 to {MAX_NAME} are allowed"
    if not unicodedata.category(name[0]).startswith("L"):
        return f"begins with {_called(name[0])}; a letter is needed there"
    if name.endswith(" "):
        return f"ends with {_called(' ')}"
    if "  " in name:
        return "has two spaces in a row"
    found = next((character for character in name if not _is_allowed(character)), "")
    return found and f"has {_called(found)}; letters, digits, spaces and {' '.join(_BESIDE_LETTERS[1:])} are allowed"


def _is_allowed(character: str) -> bool:
    category, made_of = unicodedata.category(character), unicodedata.decomposition(character)
    # Variants of a letter, such as wide or bold ones, look like it.
    looks_like_another = made_of.startswith("<") and not made_of.startswith(("<compat>", "<super>"))
    written = category[0] in "LM" or category == "Nd"
    return character in _BESIDE_LETTERS or (written and not looks_like_another and not _UNSEEN.match(character))


def _called(character: str) -> str:
    return f"U+{ord(character):04X} {unicodedata.name(character, '')}".strip()


def _role(text: str) -> Role:
    try:
        return Role(text)
    except ValueError:
        raise PasswordError(f"role {text!r} is none of {', '.join(role.value for role in Role)}") from None


def _checked(hashed: str) -> str:
    if not re.match(r"scrypt\$\d{4,6}\$\d{1,2}\$\d\$[0-9a-f]{32,64}\$[0-9a-f]{64}\Z", hashed):
        raise PasswordError("the hash is not scrypt$N$r$p$salt$hash")
    return hashed


def _scrypt(password: str, salt: bytes, cost: int, block: int, parallel: int) -> bytes:
    secret = password.encode("utf-8", "replace")
    return hashlib.scrypt(secret, salt=salt, n=cost, r=block, p=parallel, maxmem=_MAX_MEMORY, dklen=32)
