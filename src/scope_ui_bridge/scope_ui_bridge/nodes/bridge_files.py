"""Files that the bridge reads at its start, and the file of its sign-in token."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from pathlib import Path

from icu_common.core.configuration.config import ConfigError
from icu_common.core.goals.sequence import GestureSequence, parse_file
from icu_common.core.panel.panel_layout import LayoutError, PanelLayout, load_layout
from scope_ui_bridge.adapters.secret_files import AuditFile, write_secret
from scope_ui_bridge.core.config import BridgeConfig
from scope_ui_bridge.core.records import AuditError
from scope_ui_bridge.core.status import stored_name


def read_layout(config: BridgeConfig) -> PanelLayout | None:
    """Return the panel's layout; None if no file is set."""
    try:
        return load_layout(Path(config.layout)) if config.layout else None
    except (OSError, LayoutError) as error:
        raise ConfigError(f"layout: {error}") from error


def open_audit(config: BridgeConfig) -> AuditFile | None:
    """Open the audit file; None if no file is set."""
    try:
        if not config.audit_file:
            return None
        return AuditFile(Path(config.audit_file).expanduser(), 1e6 * config.audit_max_mb)
    except AuditError as error:
        raise ConfigError(f"audit_file = {config.audit_file!r}: {error}; look at it and move it away") from error
    except OSError as error:
        raise ConfigError(f"audit_file = {config.audit_file!r}: {error}") from error


def read_sequences(config: BridgeConfig, report: Callable[[str], object]) -> dict[str, GestureSequence]:
    """Return the stored sequences by name; ``report`` receives what is wrong with the others."""
    found: dict[str, GestureSequence] = {}
    folder = Path(config.sequence_folder).expanduser()
    for path in sorted(folder.glob("*.yaml")) if config.sequence_folder else ():
        try:
            found[stored_name(path.stem)] = parse_file(path.read_text(encoding="utf-8"), str(path))
        except (OSError, ValueError) as error:
            report(f"this sequence is left out: {error}")
    return found


class TokenFile:
    """The file with the unused sign-in token; without a path nothing is written."""

    def __init__(self, config: BridgeConfig, report: Callable[[str], object]) -> None:
        self._path = Path(config.token_file).expanduser() if config.token_file else None
        self._report = report

    def write(self, token: str) -> None:
        """Replace the token in the file."""
        if self._path is None:
            return
        try:
            write_secret(self._path, token)
        except OSError as error:
            self._report(f"the sign-in token could not be written to {self._path}: {error}")

    def remove(self) -> None:
        """Remove the file."""
        if self._path is not None:
            with contextlib.suppress(OSError):  # for example if it could not be written
                self._path.unlink()
