"""Sign-in: a one-shot token or a password, sessions behind a cookie. Secrets stay hashed.

A token has 256 bits and cannot be guessed, so it is compared at once and a wrong one causes no waiting time. Wrong
passwords cause a waiting time for that account and address only, so guesses at one account do not block other users.
"""

from __future__ import annotations

import hashlib
import hmac
from collections import Counter, OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, replace

from scope_ui_bridge.core.access.passwords import Role, User
from scope_ui_bridge.core.admission import Bucket, OfUsers
from scope_ui_bridge.core.wire import Refusal

_MAX_FAILURES = 1024
_MAX_SESSIONS = 256
MAX_OF_USER = 8
"""Maximum number of sessions of one user; a new one beyond it ends the user's oldest."""
_SIGN_INS_PER_S, _SIGN_INS_BURST = 0.2, 10.0
"""Maximum rate and burst of sign-ins to one account by password; each takes 0.1 s of a processor."""
AGAIN = "renewal"
"""Address of a signed-in user who signs in again, so that other people's guesses from the same address do not count."""
_FIRST_WAIT_S, _LONGEST_WAIT_S = 0.5, 10.0


@dataclass(frozen=True, slots=True, kw_only=True)
class PageSession:
    """A signed-in browser; ``name`` is its user's name on pages and in records.

    ``user`` is the line of the passwords file used for the sign-in, None for a token.
    """

    name: str
    role: Role
    ends_s: float
    user: User | None = None


@dataclass(slots=True)
class _Failures:
    count: int = 0
    blocked_until_s: float = 0.0


class SignIn:
    """Issues tokens and turns each, or a checked password, into a session.

    Parameters
    ----------
    new_secret
        Returns an unguessable text (``secrets.token_urlsafe``).
    session_lifetime_s
        Duration of a session in seconds.
    token_role
        Role of a user who signs in by a token.

    Attributes
    ----------
    spares
        Returns whether a user is or was the operator: these sessions are ended last.
    """

    def __init__(
        self, new_secret: Callable[[], str], session_lifetime_s: float, token_role: Role = Role.OPERATOR
    ) -> None:
        self._new_secret = new_secret
        self._lifetime_s = session_lifetime_s
        self._token_role = token_role
        self._token = b""
        self._sessions: OrderedDict[bytes, PageSession] = OrderedDict()
        self._failures: OrderedDict[tuple[str, str], _Failures] = OrderedDict()
        self._rates = OfUsers(lambda: Bucket(_SIGN_INS_PER_S, _SIGN_INS_BURST))
        self._pushed_out: list[tuple[PageSession, str]] = []
        self._count = 0
        self.spares: Callable[[str], bool] = lambda name: False

    def issue_token(self) -> str:
        """Return a new token that signs in once; an unused older one becomes void."""
        token = self._new_secret()
        self._token = _digest(token)
        return token

    def enter(self, token: str, now_s: float) -> str:
        """Use the token up and return the cookie's value; refuses a wrong token (``wrong_token``)."""
        self.use_up(token)
        self._count += 1
        return self._admit(f"Operator {self._count}", self._token_role, now_s)

    def use_up(self, token: str) -> None:
        """Use the token up for a user who is already signed in; refuses as :meth:`enter`."""
        if not self._token or not hmac.compare_digest(_digest(token), self._token):
            raise Refusal("wrong_token")
        self._token = b""

    def check_wait(self, account: str, remote: str, now_s: float) -> None:
        """Refuse (``wait``) before the slow check of a password.

        The reason is a waiting time after wrong passwords for this account from this address, or too many sign-ins to
        the account.
        """
        rate = self._rates.get(account) if remote != AGAIN else None
        if rate is not None and rate.take(now_s, 0.0) and rate.wait_s() > 0:
            raise Refusal("wait", seconds=max(round(rate.wait_s(), 1), 0.1))
        failures = self._failures.get((account, remote))
        if failures is not None and now_s < failures.blocked_until_s:
            raise Refusal("wait", seconds=round(failures.blocked_until_s - now_s, 1))

    def enter_by_password(self, user: User | None, account: str, remote: str, now_s: float) -> str:
        """Return the cookie's value for a user with a correct password; ``wrong_password`` for None."""
        known = self.check_user(user, account, remote, now_s)
        rate = self._rates[known.name]
        if not rate.take(now_s):
            raise Refusal("wait", seconds=max(round(rate.wait_s(), 1), 0.1))
        return self._admit(known.name, known.role, now_s, known)

    def check_user(self, user: User | None, account: str, remote: str, now_s: float) -> User:
        """Refuse (``wrong_password``) if the password was correct for no user (None)."""
        if user is None:
            self._failed(account, remote, now_s)
            raise Refusal("wrong_password")
        self._failures.pop((account, remote), None)
        return user

    def renew(self, cookie: str, now_s: float) -> PageSession | None:
        """Extend a session that has not ended to the duration of a new one; return it, or None."""
        session = self.session(cookie, now_s)
        if session is None:
            return None
        renewed = replace(session, ends_s=now_s + self._lifetime_s)
        self._sessions[_digest(cookie)] = renewed
        self._sessions.move_to_end(_digest(cookie))
        return renewed

    def _admit(self, name: str, role: Role, now_s: float, user: User | None = None) -> str:
        secret = self._new_secret()
        self._sessions[_digest(secret)] = PageSession(name=name, role=role, ends_s=now_s + self._lifetime_s, user=user)
        own = [key for key, session in self._sessions.items() if session.name == name]
        if len(own) > MAX_OF_USER:
            self._push_out(own[0], f"{MAX_OF_USER} newer ones of the same user")
        elif len(self._sessions) > _MAX_SESSIONS:
            self._push_out(self._most_dispensable(), f"{_MAX_SESSIONS} others have signed in since")
        return secret

    def _push_out(self, key: bytes, why: str) -> None:
        self._pushed_out.append((self._sessions.pop(key), why))

    def _most_dispensable(self) -> bytes:
        """Return the oldest session of the user with most sessions, preferably of a user who never had control."""
        counts = Counter(session.name for session in self._sessions.values())
        newest = next(reversed(self._sessions))
        others = ((key, session.name) for key, session in self._sessions.items() if key != newest)
        return min(others, key=lambda one: (self.spares(one[1]), -counts[one[1]]))[0]

    def _failed(self, account: str, remote: str, now_s: float) -> None:
        failures = self._failures.get((account, remote), _Failures())
        failures.count += 1
        failures.blocked_until_s = now_s + min(_FIRST_WAIT_S * 2 ** min(failures.count - 1, 20), _LONGEST_WAIT_S)
        self._failures[account, remote] = failures
        self._failures.move_to_end((account, remote))
        while len(self._failures) > _MAX_FAILURES:
            self._failures.popitem(last=False)

    def session(self, cookie: str, now_s: float) -> PageSession | None:
        """Return the session of a cookie, or None."""
        session = self._sessions.get(_digest(cookie)) if cookie else None
        return session if session is not None and now_s < session.ends_s else None

    def leave(self, cookie: str) -> None:
        """End a session."""
        self._sessions.pop(_digest(cookie), None)

    def take_ended(self, now_s: float) -> list[tuple[PageSession, str]]:
        """Remove the sessions that have expired or were replaced; return each once, with the reason."""
        over = [key for key, session in self._sessions.items() if now_s >= session.ends_s]
        ended = [(self._sessions.pop(key), "its time was over") for key in over]
        ended += self._pushed_out
        self._pushed_out = []
        return ended


def _digest(secret: str) -> bytes:
    return hashlib.sha256(secret.encode("utf-8", "replace")).digest()
