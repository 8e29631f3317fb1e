"""The connected pages and their users."""

from __future__ import annotations

from collections import deque

from scope_ui_bridge.core.access import Role, Viewer
from scope_ui_bridge.core.admission import KEPT_PLACES, OfUsers, UserBudget
from scope_ui_bridge.core.wire import Refusal

_REMEMBERED = 32  # users who have or have had control


class Pages:
    """Each connected page under its id."""

    def __init__(self) -> None:
        self._viewers: dict[str, Viewer] = {}
        self._count = 0
        self._budgets = OfUsers(UserBudget)
        self._had_control: deque[str] = deque(maxlen=_REMEMBERED)

    def __len__(self) -> int:
        return len(self._viewers)

    def __contains__(self, viewer: str) -> bool:
        return viewer in self._viewers

    def __getitem__(self, viewer: str) -> Viewer:
        return self._viewers[viewer]

    def add(self, name: str, role: Role, limit: int) -> str:
        """Add a page of the user ``name`` and return its id; some slots are reserved for those who had control.

        Raises
        ------
        Refusal
            ``too_many_viewers``.
        """
        kept = KEPT_PLACES if self.had_control(name) else 0
        if len(self._viewers) >= limit + kept:
            raise Refusal("too_many_viewers", limit=limit)
        self._count += 1
        viewer = f"v{self._count}"
        self._viewers[viewer] = Viewer(name, role, user=self._budgets[name])
        return viewer

    def remove(self, viewer: str) -> None:
        """Forget a page."""
        self._viewers.pop(viewer, None)

    def name_of(self, viewer: str) -> str:
        """Return the user of a page; empty if the page is gone."""
        return self._viewers[viewer].name if viewer in self._viewers else ""

    def engineers(self) -> list[str]:
        """Return the pages of engineers."""
        return [viewer for viewer, page in self._viewers.items() if page.role is Role.ENGINEER]

    def had_control(self, name: str) -> bool:
        """Return whether a user has or has had control."""
        return name in self._had_control

    def got_control(self, name: str) -> None:
        """Record that a user has control."""
        if name not in self._had_control:
            self._had_control.append(name)
