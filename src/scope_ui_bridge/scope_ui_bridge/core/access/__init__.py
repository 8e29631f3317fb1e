"""Users: who is signed in, and what a user's page may send.

Enters: names, passwords, tokens, and each message of a page before it is read. Leaves: a ``PageSession`` with a
``Role``, or a refusal. ``passwords`` has users and hashes, ``sign_in`` tokens, sessions and waiting times after wrong
passwords, and ``viewer`` one page with its rates.
"""

from scope_ui_bridge.core.access.passwords import (
    MAX_NAME,
    PasswordError,
    Role,
    User,
    composed,
    hash_password,
    matches,
    new_user,
    parse_users,
)
from scope_ui_bridge.core.access.sign_in import AGAIN, PageSession, SignIn
from scope_ui_bridge.core.access.viewer import FLOODING, SHORT, Viewer

__all__ = [
    "AGAIN",
    "FLOODING",
    "MAX_NAME",
    "SHORT",
    "PageSession",
    "PasswordError",
    "Role",
    "SignIn",
    "User",
    "Viewer",
    "composed",
    "hash_password",
    "matches",
    "new_user",
    "parse_users",
]
