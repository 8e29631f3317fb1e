"""What bring-up and the programs that it starts tell each other, by environment variables and exit codes."""

from __future__ import annotations

READY_VARIABLE = "ICU_READY_FD"
"""Names the file descriptor to which a program writes a byte when it is ready, and then as a sign of life."""

SIGN_OF_LIFE_S = 1.0
"""So long after the last one comes the next sign of life."""

LONGEST_CALLBACK_S = 120.0
"""A callback that lasts longer is taken for one that never ends. The longest one compiles for changed parameters."""

AFTER_CRASH_VARIABLE = "ICU_AFTER_CRASH"
"""Set in the environment of a program whose predecessor was ended by a signal."""

HANGING_VARIABLE = "ICU_HANGING_FILE"
"""Names the file in which bring-up writes which programs hang: see icu_common.adapters.hanging_programs."""

DEAF = 75
"""Exit code of a program that is to be started anew (EX_TEMPFAIL of sysexits.h): see icu_common.nodes.hearing."""
