"""Which programs use the processor, as values; icu_common.adapters.processes.processor_load measures them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from icu_common.core.reasons.message import Message

LISTED = 3
"""Maximum number of programs named in a message."""
LEAST_PERCENT = 10.0
"""Minimum share of one core, in percent, for which a program is named."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ProgramLoad:
    """One program: ``percent`` is its share of one core; ``own``: it belongs to the robot."""

    name: str
    percent: float
    own: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class ProcessorLoad:
    """Use of the processor over about the last second.

    Parameters
    ----------
    cores
        Number of cores that this process may use.
    load_average
        Load average of the last minute.
    programs
        The programs that use the processor, the largest share first.
    """

    cores: int
    load_average: float
    programs: tuple[ProgramLoad, ...]

    @property
    def busy(self) -> bool:
        """Whether the programs leave less than a tenth of the cores idle."""
        return sum(program.percent for program in self.programs) > 90.0 * self.cores

    def text(self) -> str:
        """Return one clause for people."""
        named = [p for p in self.programs if p.percent >= LEAST_PERCENT][:LISTED]
        shares = ", ".join(f"{p.name}{' (robot)' if p.own else ''} {p.percent:.0f} %" for p in named)
        robot, others = (sum(p.percent for p in self.programs if p.own is own) for own in (True, False))
        whole = Message("computer.robot_uses_other_programs", robot_percent=robot, others_percent=others)
        return Message(
            "computer.load_cores",
            load_average=self.load_average,
            cores=self.cores,
            whole=whole,
            shares=shares or Message("computer.none_needs_much"),
        )


def sorted_loads(loads: Iterable[ProgramLoad]) -> tuple[ProgramLoad, ...]:
    """Add up the processes of the same program and sort by share."""
    total: dict[tuple[str, bool], float] = {}
    for load in loads:
        total[load.name, load.own] = total.get((load.name, load.own), 0.0) + load.percent
    found = [ProgramLoad(name=name, percent=percent, own=own) for (name, own), percent in total.items()]
    return tuple(sorted(found, key=lambda load: (-load.percent, load.name)))


def program_name(executable: str, arguments: Iterable[str]) -> str:
    """Return the name of a program: that of the script where an interpreter runs one."""
    given = list(arguments)
    if executable.startswith(("python", "pypy", "node", "perl", "ruby")) and "-c" not in given[1:2]:
        script = next((text for text in given[1:] if not text.startswith("-")), "")
        is_module = "-m" in given[1:2]
        executable = (script if is_module else script.rpartition("/")[2]) or executable
    return executable[:40]


def is_of_robot(arguments: Iterable[str], packages: Iterable[str]) -> bool:
    """Return whether a command line runs an installed program of one of the packages (PREFIX/lib/PACKAGE/PROGRAM)."""
    places = tuple(f"/lib/{package}/" for package in packages)
    return any(place in text for text in list(arguments)[:2] for place in places)
