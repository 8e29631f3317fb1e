"""Names, roles and hashed passwords: one line each, ``name:role:scrypt$N$r$p$salt$hash`` (RFC 7914, hexadecimal).

scrypt costs 32 MiB and about a tenth of a second for each guess; it comes with Python, so nothing has to be installed.
"""

from __future__ import annotations

import enum
import hashlib
import hmac
import re
from collections.abc import Iterable
from dataclasses import dataclass

_COST, _BLOCK, _PARALLEL = 2**15, 8, 1
_MAX_MEMORY = 64 * 2**20
MIN_PASSWORD, MAX_PASSWORD = 10, 256
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9 ._-]{0,31}\Z")


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
    if not _NAME.match(name):
        raise PasswordError(f"name {name!r}: a letter and up to 31 letters, digits, spaces, '.', '-' or '_' are needed")
    return User(name=name, role=_role(role), hashed=hash_password(password, salt))


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
            if not _NAME.match(name) or name in users:
                raise PasswordError(f"name {name!r} is not allowed or stands twice")
            users[name] = User(name=name, role=_role(role), hashed=_checked(hashed))
        except ValueError as error:
            raise PasswordError(f"line {number}: {error}") from error
    return users


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
