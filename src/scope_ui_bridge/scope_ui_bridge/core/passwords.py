"""Names, roles and hashed passwords: one line each, ``name:role:scrypt$N$r$p$salt$hash`` (RFC 7914, hexadecimal).

A name is written in the letters of any language, composed (NFC); nothing in it may be unseen or look like another.

scrypt costs 32 MiB and about a tenth of a second for each guess; it comes with Python, so nothing has to be installed.
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
# Letters and marks that show nothing (Default_Ignorable_Code_Point of Unicode).
_UNSEEN = re.compile("[\u034f\u115f\u1160\u17b4\u17b5\u180b-\u180f\u3164\ufe00-\ufe0f\uffa0\U000e0000-\U000e0fff]")


class Role(enum.Enum):
    """What a user may do; each may also do what those before it may. All of them may stop."""

    VIEWER = "viewer"
    OPERATOR = "operator"
    ENGINEER = "engineer"

    def may(self, needed: Role) -> bool:
        """Tell whether this role includes ``needed``."""
        order = list(Role)
        return order.index(self) >= order.index(needed)


class PasswordError(ValueError):
    """A line of the file, a name or a password is no good; the message says which and what is needed."""


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
        When the password is too short or too long.
    """
    if not MIN_PASSWORD <= len(password) <= MAX_PASSWORD:
        raise PasswordError(f"a password of {len(password)} characters: {MIN_PASSWORD} to {MAX_PASSWORD} are needed")
    return f"scrypt${_COST}${_BLOCK}${_PARALLEL}${salt.hex()}${_scrypt(password, salt, _COST, _BLOCK, _PARALLEL).hex()}"


def matches(password: str, hashed: str) -> bool:
    """Tell whether a password belongs to a hash; takes as long for a wrong one."""
    _, cost, block, parallel, salt, digest = hashed.split("$")
    found = _scrypt(password[:MAX_PASSWORD], bytes.fromhex(salt), int(cost), int(block), int(parallel))
    return hmac.compare_digest(found, bytes.fromhex(digest))


def new_user(name: str, role: str, password: str, salt: bytes) -> User:
    """Return a user with the password hashed, after checking all three."""
    return User(name=checked_name(name), role=_role(role), hashed=hash_password(password, salt))


def parse_users(lines: Iterable[str]) -> dict[str, User]:
    """Read the file's lines; empty ones and those that begin with # are skipped.

    Raises
    ------
    PasswordError
        With the line's number.
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
    """Return a name as it is kept and compared, however a keyboard or a system composes its letters."""
    return unicodedata.normalize("NFC", name)


def checked_name(name: str) -> str:
    """Return a name, composed.

    Raises
    ------
    PasswordError
        With the name, what in it is not allowed, and what is.
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
    # What is only another form of a letter, as a wide or a bold one, looks like it.
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
