"""Record of commands: the action, the user and the result.

Enters: commands, their results, and changes of parameters. Leaves: log entries for the pages, and lines for the audit
file. ``command_log`` has the newest commands and those without a result, ``audit`` chains the lines of the audit file
by hashes, and ``parameter_changes`` adds changes that other programs make.
"""

from scope_ui_bridge.core.records.audit import BAD_BYTES, START, AuditError, Gap, chain_line, gaps, line_before, verify
from scope_ui_bridge.core.records.command_log import CommandLog, LogEntry, record, result_record, shown
from scope_ui_bridge.core.records.parameter_changes import ParameterChanges

__all__ = [
    "BAD_BYTES",
    "START",
    "AuditError",
    "CommandLog",
    "Gap",
    "LogEntry",
    "ParameterChanges",
    "chain_line",
    "gaps",
    "line_before",
    "record",
    "result_record",
    "shown",
    "verify",
]
