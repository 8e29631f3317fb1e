"""Comparison of the modes that ``$G`` reports with those on which the next lines depend."""

from __future__ import annotations

import re
from dataclasses import dataclass

ASK_MODES = "$G"
"""Query of the modes: allowed at any time, without effect, and answered in turn by a distinct text."""
_FEED = re.compile(r"F(\d+(?:\.\d*)?)\Z")
_SPINDLE = re.compile(r"S(\d+(?:\.\d*)?)\Z")


@dataclass(frozen=True, slots=True, kw_only=True)
class RequiredModes:
    """Modes that must be in force.

    Parameters
    ----------
    words
        Words that ``[GC:..]`` must contain, such as ``G21``.
    feed_mm_min, spindle
        The F and S values; None if they do not matter.
    """

    words: frozenset[str]
    feed_mm_min: float | None = None
    spindle: float | None = None

    def missing(self, reported: str) -> str:
        """Return the modes that the text of a ``[GC:..]`` lacks, empty if it has all.

        Boards print the feed as a whole number.

        Examples
        --------
        >>> wanted = RequiredModes(words=frozenset({"G21", "G90"}), feed_mm_min=600.0)
        >>> wanted.missing("G1 G54 G17 G21 G91 G94 M5 M9 T0 F600 S0")
        'G90'
        """
        found = set(reported.split())
        missing = sorted(self.words - found)
        for letter, pattern, wanted in (("F", _FEED, self.feed_mm_min), ("S", _SPINDLE, self.spindle)):
            values = [float(match[1]) for word in found if (match := pattern.match(word))]
            if wanted is not None and not any(abs(value - wanted) <= 0.51 for value in values):
                missing.append(f"{letter}{wanted:g}")
        return " ".join(missing)
