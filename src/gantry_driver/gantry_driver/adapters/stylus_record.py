"""A small file that records, across restarts of the driver, that the stylus may be down."""

from __future__ import annotations

from pathlib import Path

DOWN, UP = "down", "up"


class StylusRecord:
    """Reads and writes the file; only a file that contains ``up`` counts as up.

    Parameters
    ----------
    path
        The file; its folder is created with it. None: nothing is recorded.
    """

    def __init__(self, path: Path | None) -> None:
        self._path = path

    def may_be_down(self) -> bool:
        """Return the record of the last driver: True also for an unreadable file, False if there is none."""
        if self._path is None:
            return False
        try:
            return self._path.read_text(encoding="ascii").strip() != UP
        except FileNotFoundError:
            return False
        except (OSError, UnicodeError):
            return True

    def remove_if_up(self) -> None:
        """Delete the file unless the stylus may be down."""
        if self._path is not None and not self.may_be_down():
            self._path.unlink(missing_ok=True)

    def write(self, may_be_down: bool) -> None:
        """Replace the file atomically, so that a kill leaves the old or the new one.

        Raises
        ------
        OSError
            If the file cannot be written.
        """
        if self._path is None:
            return
        self._path.parent.mkdir(parents=True, exist_ok=True)
        fresh = self._path.with_name(f"{self._path.name}.new")
        fresh.write_text(f"{DOWN if may_be_down else UP}\n", encoding="ascii")
        fresh.replace(self._path)
