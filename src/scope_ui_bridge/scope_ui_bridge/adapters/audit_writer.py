"""Records on disk, in order, without waiting in the event loop."""

from __future__ import annotations

import logging
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

from scope_ui_bridge.adapters.secret_files import AuditFile

_LOG = logging.getLogger(__name__)


class AuditWriter:
    """Writes to the audit file in a thread of its own, which keeps the records in order.

    Parameters
    ----------
    audit
        File for the records of commands, or None.
    """

    def __init__(self, audit: AuditFile | None) -> None:
        self._audit = audit
        self._thread = ThreadPoolExecutor(1, "audit")

    def write(self, record: dict[str, Any]) -> Future[None]:
        """Queue a record for the writer; the future is done when the record is on disk.

        The call queues at once, without a task: tasks end with the event loop, and the last stop is sent when the loop
        ends.
        """
        try:
            return self._thread.submit(self._append, record)
        except RuntimeError as error:  # the writer has ended
            failed: Future[None] = Future()
            failed.set_exception(OSError(str(error)))
            return failed

    def write_later(self, record: dict[str, Any]) -> None:
        """Queue a record; a failure is logged."""
        self.write(record).add_done_callback(_report_failure)

    def close(self) -> None:
        """Write what is queued, and close the file."""
        self._thread.shutdown(wait=True)
        if self._audit is not None:
            self._audit.close()

    def _append(self, record: dict[str, Any]) -> None:
        if self._audit is not None:
            self._audit.append(record)


def _report_failure(written: Future[None]) -> None:
    if (error := written.exception()) is not None:
        _LOG.error("the record could not be written: %s", error)
