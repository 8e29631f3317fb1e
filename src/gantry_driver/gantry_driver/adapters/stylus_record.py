"""A small file that keeps, over restarts of the driver, that the stylus may be down."""

from __future__ import annotations

from pathlib import Path

DOWN, UP = "down", "up"


class StylusRecord:
    """Reads and writes the file; only what ``up`` is written in counts as up.

    Parameters
    ----------
    path
        The file; its folder is made when it is written. None: nothing is kept.
    """

    def __init__(self, path: Path | None) -> None:
        self._path = path

    def may_be_down(self) -> bool:
        """Return what the last driver left: also True for a file that cannot be read, False where there is none."""
        if self._path is None:
            return False
        try:
            return self._path.read_text(encoding="ascii").strip() != UP
        except FileNotFoundError:
            return False
        except (OSError, UnicodeError):
            return True

    def write(self, may_be_down: bool) -> None:
        """Replace the file at once, so that a kill leaves the old or the new one.

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
