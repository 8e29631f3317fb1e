"""The full campaign: ``python -m campaign.run --seeds 1000``; prints its seeds, and how to repeat one that fails."""

from __future__ import annotations

import argparse
import collections
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from campaign.faults import FAULTS, config_of, fault_of, run_seed
from campaign.port_rig import PortRig
from campaign.virtual_link import VirtualRig

LINK_FAULTS = ("unplug", "brown-out", "soft reset", "full", "vanishes", "EEPROM pause", "operator stop")
"""Those that go through the port's own code, worth their real time."""


def seeds(text: str) -> range:
    """Return the seeds of ``COUNT`` or ``FIRST:LAST`` (LAST is not among them)."""
    first, _, last = text.rpartition(":")
    found = range(int(first or 0), int(last))
    if not found and int(last):
        raise argparse.ArgumentTypeError(f"{text} names no seed")
    return found


def port_seeds(count: int) -> Iterator[int]:
    """Return the first ``count`` seeds whose fault goes through the port."""
    seed = 0
    while count:
        if fault_of(seed).name in LINK_FAULTS:
            yield seed
            count -= 1
        seed += 1


def run_on_port(seed: int) -> str:
    with tempfile.TemporaryDirectory() as folder, PortRig(config_of(seed), seed, Path(folder)) as rig:
        return run_seed(seed, rig)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the campaign; 1 if a promise was broken."""
    parser = argparse.ArgumentParser(prog="campaign", description=__doc__)
    parser.add_argument("--seeds", type=seeds, default=range(1000), metavar="N|A:B", help="in virtual time (1000)")
    parser.add_argument("--port-seeds", type=int, metavar="N", help="on a pseudo-terminal (20 with 100 seeds or more)")
    given = parser.parse_args(arguments)
    if given.port_seeds is None:
        given.port_seeds = 20 if len(given.seeds) >= 100 else 0
    outcomes: collections.Counter[str] = collections.Counter()
    broken: list[str] = []
    began = time.monotonic()
    jobs = [("", seed) for seed in given.seeds] + [(" on a port", seed) for seed in port_seeds(given.port_seeds)]
    if given.seeds:
        print(f"seeds {given.seeds[0]} to {given.seeds[-1]}, {len(FAULTS)} faults; {given.port_seeds} on a port")
    for number, (where, seed) in enumerate(jobs, 1):
        try:
            outcomes[run_on_port(seed) if where else run_seed(seed, VirtualRig(config_of(seed), seed))] += 1
        except Exception as error:
            broken.append(f"seed {seed} ({fault_of(seed).name}){where}: {type(error).__name__}: {error}")
            print(f"\r{broken[-1]}")
        if sys.stdout.isatty() or number % 100 == 0 or number == len(jobs):
            end = "" if sys.stdout.isatty() and number < len(jobs) else "\n"
            elapsed = time.monotonic() - began
            print(f"\r{number} of {len(jobs)} runs, {len(broken)} broken, {elapsed:.0f} s", end=end, flush=True)
    for outcome, count in sorted(outcomes.items()):
        print(f"  {outcome:<30} {count}")
    for text in broken:
        seed = text.split()[1]
        print(f"repeat with: make campaign CAMPAIGN_SEEDS={seed}:{int(seed) + 1}   # {text[:100]}")
    return 1 if broken else 0


if __name__ == "__main__":
    raise SystemExit(main())
