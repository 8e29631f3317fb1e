"""Check, from the stylus tracker's reports, that the right camera is where the tip's measurement assumes it."""

from __future__ import annotations

from collections.abc import Iterator

from gantry_driver.core.job.controller_config import ControllerConfig
from gantry_driver.core.job.goal_job import Obstacle
from icu_common.core.alignment.findings import Finding, FindingCode
from icu_common.core.alignment.pair import PairCode, PairState
from icu_common.core.reasons.codes import ControllerCode
from icu_common.core.reasons.state_text import because

_CODES = {
    FindingCode.CAMERA_MOVED: ControllerCode.CAMERA_MOVED,
    FindingCode.CAMERA_CHANGING: ControllerCode.CAMERA_CHANGING,
    FindingCode.CAMERA_UNCHECKED: ControllerCode.CAMERA_UNCHECKED,
}


def pair_finding(pair: PairState | None, age_s: float, config: ControllerConfig) -> Finding | None:
    """Return the finding that forbids a touch, None if there is none or no tracker reports the pair.

    Parameters
    ----------
    pair, age_s
        State that the tracker reports, and its age in seconds.
    config
        Limits.
    """
    if pair is None or pair.code is PairCode.UNKNOWN:
        return None
    if pair.code is PairCode.MOVED:
        return Finding(code=FindingCode.CAMERA_MOVED, values=(*_turn(pair), ("limit_deg", f"{pair.limit_deg:g}")))
    if pair.code is PairCode.CHANGING:
        return Finding(code=FindingCode.CAMERA_CHANGING, values=_turn(pair))
    if age_s > config.pair_max_age_s:
        values = (("age_s", f"{age_s:.1f}"), ("limit_s", f"{config.pair_max_age_s:g}"))
        return Finding(code=FindingCode.CAMERA_UNCHECKED, values=values)
    return None


def pair_obstacles(finding: Finding | None) -> Iterator[Obstacle]:
    """Yield the obstacles to the start of a touch; a camera that is still moving may come to rest by itself."""
    if finding is not None:
        passing = finding.code is not FindingCode.CAMERA_MOVED
        yield Obstacle(
            code=_CODES[finding.code],
            state=because("waiting", finding.text()),
            reason=finding.text(),
            every_goal=False,
            passing=passing,
            delay=finding,
        )


def turned_since(before: PairState | None, now: PairState | None, limit_px: float) -> Finding | None:
    """Return a finding if the right camera has turned by more than ``limit_px`` between two states."""
    if before is None or now is None or not before.known or not now.known:
        return None
    turn = abs(now.rotation_rad - before.rotation_rad)[:2].max() * now.focal_px
    return Finding(code=FindingCode.CAMERA_CHANGING, values=_turn(now)) if turn > limit_px else None


def _turn(pair: PairState) -> tuple[tuple[str, str], ...]:
    return ("turn_deg", f"{pair.turn_deg:.3f}"), ("turn_px", f"{pair.turn_px:.2f}")
