"""Quota of processor time for a group of processes, by Linux control groups (version 1 or 2)."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path("/sys/fs/cgroup")
_PERIOD_US = 10_000
"""Period of the quota: short, so that a process is slowed down instead of paused for a noticeable time."""
_EMPTY_WITHIN_S = 10.0


class NoQuota(Exception):
    """No quota is possible on this system; the message is the reason."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Throttling:
    """Number of periods in which the group needed more than its quota, and of all periods in which it ran."""

    throttled: int
    periods: int

    @property
    def share(self) -> float:
        """Share of throttled periods, 0 to 1."""
        return self.throttled / self.periods if self.periods else 0.0


class CpuQuota:
    """One control group; use :func:`cpu_quota`."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def take(self, pid: int) -> None:
        """Add a process to the group, and all processes that it starts from now on."""
        (self._folder / "cgroup.procs").write_text(str(pid))

    def throttling(self) -> Throttling:
        """Return the current counts."""
        lines = (line.split() for line in (self._folder / "cpu.stat").read_text().splitlines())
        values = {name: int(value) for name, value in lines}
        return Throttling(throttled=values["nr_throttled"], periods=values["nr_periods"])


@contextlib.contextmanager
def cpu_quota(cores: float) -> Iterator[CpuQuota]:
    """Create a cgroup with the processor time of ``cores`` cores, on any number of cores; remove it at the end.

    Raises
    ------
    NoQuota
        If the system has no control group for processor time, or does not permit creating one.
    """
    folder, quota = _group(), round(cores * _PERIOD_US)
    try:
        folder.mkdir()
    except OSError as error:
        raise NoQuota(f"{folder} cannot be made: {error.strerror}") from error
    try:
        try:
            if (folder / "cpu.max").exists():
                (folder / "cpu.max").write_text(f"{quota} {_PERIOD_US}")
            else:
                (folder / "cpu.cfs_period_us").write_text(str(_PERIOD_US))
                (folder / "cpu.cfs_quota_us").write_text(str(quota))
        except OSError as error:
            raise NoQuota(f"{folder} takes no quota: {error.strerror}") from error
        yield CpuQuota(folder)
    finally:
        deadline = time.monotonic() + _EMPTY_WITHIN_S
        while (folder / "cgroup.procs").read_text() and time.monotonic() < deadline:
            time.sleep(0.1)
        folder.rmdir()


def _group() -> Path:
    name = f"icu_bench_{os.getpid()}"
    controllers = ROOT / "cgroup.controllers"
    if controllers.exists():
        if "cpu" not in (ROOT / "cgroup.subtree_control").read_text().split():
            raise NoQuota(f"{ROOT}/cgroup.subtree_control does not name the controller cpu")
        return ROOT / name
    for version_1 in (ROOT / "cpu", ROOT / "cpu,cpuacct"):
        if (version_1 / "cpu.cfs_quota_us").exists():
            return version_1 / name
    raise NoQuota(f"no control group for processor time in {ROOT}")
