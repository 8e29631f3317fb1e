"""Test whether a machine is built, set and calibrated well enough: travel, axes, cameras and touches, with a report.

Exit codes: 0 accepted, 1 not accepted or aborted, 2 wrong usage, 3 no answer in time.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2

from gantry_driver.acceptance.checks import all_checks
from gantry_driver.acceptance.limits import AcceptanceLimits, limits_of
from gantry_driver.acceptance.plots import marked_image
from gantry_driver.acceptance.report import as_html, as_json, line, passed
from gantry_driver.cli.acceptance_run import AcceptanceRun, NotPossible
from gantry_driver.cli.operator_session import (
    FAILED,
    REACHED,
    TIMED_OUT,
    USAGE,
    Interrupted,
    TimedOut,
    complain,
    operator_session,
    say,
)
from icu_common.adapters.processes.program_end import ends_quietly
from icu_common.core.configuration.config import ConfigError, settings_of
from icu_common.core.configuration.option_bounds import check_bounds, named_path
from icu_common.nodes.runtime import own_arguments

MOST_TOUCHES = 200
_JPEG = (cv2.IMWRITE_JPEG_QUALITY, 85)


@dataclass(frozen=True, slots=True, kw_only=True)
class AcceptanceOptions:
    """The command line's order: the folder of the report, the number of touches, the limits, and the machine's name."""

    out: Path
    touches: int
    limits: AcceptanceLimits
    machine: str


def parse(arguments: Sequence[str]) -> AcceptanceOptions:
    """Read the arguments.

    Raises
    ------
    SystemExit
        With code 2 and the usage for wrong arguments, as argparse does.
    """
    named = "; ".join(f"{item.name} ({item.default:g})" for item in settings_of(AcceptanceLimits))
    parser = argparse.ArgumentParser(
        prog="gantry_accept",
        description="Test a prepared machine: visit the corners of its travel, measure direction, scale, squareness "
        "and backlash of the axes by the cameras, check focus and coverage of the cameras, touch points of the "
        "panel away from its controls, and write report.html and report.json. The same command tests the simulated "
        "bench and hardware.",
        epilog=f"Limits and their defaults: {named}.",
    )
    parser.add_argument("-o", "--out", type=named_path, default=Path("acceptance"), help="folder (default acceptance)")
    parser.add_argument("--touches", type=int, default=20, metavar="N", help="number of touches (default 20)")
    parser.add_argument("--machine", default="", metavar="NAME", help="name of the machine, for the report")
    parser.add_argument(
        "--limit", action="append", default=[], metavar="NAME=VALUE", help="another limit; may be given several times"
    )
    given = parser.parse_args(arguments)
    try:
        check_bounds(given, touches=(0, MOST_TOUCHES))
        limits = limits_of(given.limit)
    except (ConfigError, ValueError) as error:
        parser.error(str(error))
    return AcceptanceOptions(out=given.out, touches=given.touches, limits=limits, machine=given.machine)


def write_report(run: AcceptanceRun, order: AcceptanceOptions, about: dict[str, str]) -> bool:
    """Print the checks, write both files, and return whether the machine is accepted."""
    measured = run.measured
    checks = all_checks(measured, order.limits)
    for check in checks:
        say(line(check))
    pictures = [
        (f"{camera.name} camera", cv2.imencode(".jpg", marked_image(camera, measured.touches), _JPEG)[1].tobytes())
        for camera in measured.cameras
    ]
    order.out.mkdir(parents=True, exist_ok=True)
    page, values = order.out / "report.html", order.out / "report.json"
    page.write_text(as_html(measured, checks, order.limits, about, pictures), encoding="utf-8")
    values.write_text(as_json(measured, checks, order.limits, about), encoding="utf-8")
    accepted = passed(checks)
    failed = sum(not check.passed for check in checks)
    say(f"{'accepted' if accepted else f'not accepted: {failed} of {len(checks)} checks failed'}; {page}, {values}")
    return accepted


@ends_quietly
def main(arguments: Sequence[str] | None = None) -> int:
    arguments = list(sys.argv if arguments is None else arguments)
    order = parse(own_arguments(arguments))
    began = time.monotonic()
    about = {"started": time.strftime("%Y-%m-%d %H:%M:%S %z"), "machine": order.machine or "not named"}
    with operator_session("gantry_accept", arguments) as session:
        try:
            run = AcceptanceRun(session, order.touches)
            run.prepare()
            started_ns = session.now_ns()
            run.travel()
            run.touch()
            run.look()
            about["duration"] = f"{(session.now_ns() - started_ns) / 1e9:.0f} s"
        except NotPossible as error:
            complain(str(error))
            return FAILED
        except TimedOut as error:
            complain(str(error))
            session.stop()
            return TIMED_OUT
        except Interrupted:
            say("interrupted: stopping")
            session.stop()
            return FAILED
    run.evaluate()
    try:
        accepted = write_report(run, order, about)
    except OSError as error:
        complain(f"the report cannot be written: {error}")
        return USAGE
    say(f"{time.monotonic() - began:.0f} s in all")
    return REACHED if accepted else FAILED


if __name__ == "__main__":
    raise SystemExit(main())
