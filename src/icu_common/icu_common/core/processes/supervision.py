"""Environment variables and exit codes by which bring-up and its programs communicate."""

from __future__ import annotations

READY_VARIABLE = "ICU_READY_FD"
"""Variable with the file descriptor to which a program writes a byte when it is ready, and then as a sign of life."""

SIGN_OF_LIFE_S = 1.0
"""Interval in seconds between two signs of life."""

LONGEST_CALLBACK_S = 120.0
"""Seconds after which a callback is treated as one that never ends. The longest one compiles for new parameters."""

AFTER_CRASH_VARIABLE = "ICU_AFTER_CRASH"
"""Variable that is set for a program whose predecessor was ended by a signal."""

HANGING_VARIABLE = "ICU_HANGING_FILE"
"""Variable with the file of the hanging programs: see icu_common.adapters.processes.hanging_programs."""

DEAF = 75
"""Exit code of a program that must be restarted (EX_TEMPFAIL of sysexits.h): see ``icu_common.nodes.hearing``."""
