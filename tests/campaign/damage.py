"""The damage campaign: ``python -m campaign.damage --seeds 20000``; one damaged byte (or burst) a run.

Each seed of a direction repeats one run in virtual time: a phase, a kind of damage, a control on a panel, and the byte
that is damaged. The verdict comes from the board's own record of where the stylus was.
"""

from __future__ import annotations

import argparse
import collections
import dataclasses
import gc
import json
import multiprocessing
import os
import random
import sys
import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from campaign.damage_judge import HARMLESS, REPORTED, STOPPED, VERDICTS, WRONG, Judge
from campaign.damage_phases import PHASES, Scene, carry_out, scene_of
from campaign.damage_rig import DIRECTIONS, DamageRig
from campaign.other_damage import OtherDamage
from campaign.run import seeds

from gantry_driver.core.configuration.machine_config import DriverConfig
from gantry_driver.mock.serial_line import Damage

CONFIG = DriverConfig(enabled_at_start=True)
NAMES = tuple(PHASES)
KINDS: dict[str, type[Damage]] = {"bytes": Damage, "other": OtherDamage}
CHUNK = 22
"""Seeds that a process takes at a time."""
SHOWN = 5
"""Failures that are printed at once."""


@dataclasses.dataclass(frozen=True, slots=True)
class Case:
    """Parameters of one seed of one direction."""

    direction: str
    seed: int
    damage: type[Damage] = Damage

    @property
    def phase(self) -> str:
        return NAMES[self.seed % len(NAMES)]

    @property
    def kind(self) -> str:
        return self.damage.kinds[self.seed // len(NAMES) % len(self.damage.kinds)]

    def draw(self) -> tuple[Scene, random.Random]:
        other = "" if self.damage is Damage else "other "
        rng = random.Random(f"{other}{self.direction} {self.seed}")
        return scene_of(rng), rng


@dataclasses.dataclass(slots=True)
class Finding:
    """The verdict on one case, and what it rests on."""

    direction: str
    seed: int
    phase: str
    kind: str
    verdict: str
    why: list[str]
    was: str = ""
    became: str = ""
    told: list[str] = dataclasses.field(default_factory=list)
    deviated: list[str] = dataclasses.field(default_factory=list)


_spans: dict[tuple[str, str], int] = {}


def span(direction: str, phase: str) -> int:
    """Return how many bytes pass in a phase that nothing damages; the seed's byte is one of as many."""
    if (direction, phase) not in _spans:
        count = 0
        for seed in range(2):
            rng = random.Random(f"span {seed}")
            damage = Counting()
            rig = DamageRig(CONFIG, seed, damage, direction)
            carry_out(rig, phase, scene_of(rng), rng)
            count = max(count, damage.count)
        _spans[direction, phase] = count
    return _spans[direction, phase]


class Counting(Damage):
    """No damage; counts the bytes that pass, and is done after one phase."""

    def __init__(self) -> None:
        super().__init__("lost", 0, random.Random(0))
        self.count = 0

    @property
    def done(self) -> bool:
        return self.count > 0

    def apply(self, data: bytes) -> bytes:
        self.count += len(data)
        return data


def run_case(case: Case, config: DriverConfig = CONFIG) -> Finding:
    """Run one case and judge it."""
    scene, rng = case.draw()
    damage = case.damage(case.kind, rng.randrange(span(case.direction, case.phase)), rng)
    rig = DamageRig(config, case.seed, damage, case.direction)
    if isinstance(damage, OtherDamage):
        damage.clock = lambda: rig.board.now
    failure = ""
    try:
        carry_out(rig, case.phase, scene, rng)
    except Exception as error:  # a finding like any other: a wait without an end, a state that the driver lacks
        failure = f"{type(error).__name__}: {error}"
        rig.story.told.append(failure)
    judge = Judge(rig.story, rig.track)
    if failure:
        judge.wrong.append(failure)
    else:
        judge.check_end(rig)
    return Finding(
        direction=case.direction,
        seed=case.seed,
        phase=case.phase,
        kind=case.kind,
        verdict=judge.verdict(),
        why=judge.wrong,
        was=damage.was.decode("latin-1"),
        became=damage.became.decode("latin-1"),
        told=rig.story.told[:4],
        deviated=judge.deviated[:4],
    )


def run_chunk(cases: Sequence[Case]) -> list[Finding]:
    """Run some cases; what they leave behind is collected once, at the end."""
    gc.freeze()
    gc.disable()
    found = [run_case(case) for case in cases]
    gc.collect()
    return found


def chunks(cases: Sequence[Case]) -> Iterable[Sequence[Case]]:
    return (cases[first : first + CHUNK] for first in range(0, len(cases), CHUNK))


def table(findings: Sequence[Finding], direction: str) -> str:
    """Return counts by kind of damage and phase: harmless / reported / stopped in time / wrong."""
    counts: collections.Counter[tuple[str, str, str]] = collections.Counter()
    for found in findings:
        if found.direction == direction:
            for phase in (found.phase, "all"):
                for kind in (found.kind, "all"):
                    counts[phase, kind, found.verdict] += 1
    of_bytes = not findings or findings[0].kind in Damage.kinds
    kinds = [*(Damage if of_bytes else OtherDamage).kinds, "all"]
    rows = [f"| phase | {' | '.join(kinds)} |", f"|---|{'---|' * len(kinds)}"]
    for phase in (*NAMES, "all"):
        cells = [" / ".join(str(counts[phase, kind, verdict]) for verdict in VERDICTS) for kind in kinds]
        rows.append(f"| {phase} | {' | '.join(cells)} |")
    return "\n".join(rows)


def text_of(found: Finding) -> str:
    """Return a failure with its bytes, and how to repeat it."""
    lines = [f"{found.direction} seed {found.seed} ({found.phase}, {found.kind}): {found.verdict}"]
    lines += [f"  sent {found.was.encode('latin-1')!r}", f"  received {found.became.encode('latin-1')!r}"]
    lines += [f"  wrong: {text}" for text in found.why]
    lines += [f"  told: {text}" for text in found.told]
    lines += [f"  deviated: {text}" for text in found.deviated]
    kinds = "" if found.kind in Damage.kinds else " DAMAGE_KINDS=other"
    again = f"make damage DAMAGE_SEEDS={found.seed}:{found.seed + 1} DAMAGE_DIRECTION={found.direction}{kinds}"
    return "\n".join([*lines, f"  repeat with: {again}"])


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the campaign; 1 if a run was wrong."""
    parser = argparse.ArgumentParser(prog="damage", description=__doc__)
    parser.add_argument("--seeds", type=seeds, default=range(20_000), metavar="N|A:B", help="per direction (20000)")
    parser.add_argument("--direction", choices=(*DIRECTIONS, "both"), default="both")
    parser.add_argument("--kinds", choices=KINDS, default="bytes", help="of bytes, or of lines and times (bytes)")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, metavar="N", help="processes (one a core)")
    parser.add_argument("--out", type=Path, metavar="FOLDER", help="write findings.json and table.md there")
    given = parser.parse_args(arguments)
    directions = DIRECTIONS if given.direction == "both" else (given.direction,)
    # Alternating, so that a run that was broken off has seen both.
    cases = [Case(direction, seed, KINDS[given.kinds]) for seed in given.seeds for direction in directions]
    print(f"seeds {given.seeds.start} to {given.seeds.stop - 1}, {', '.join(directions)}; {given.jobs} processes")
    began = time.monotonic()
    findings: list[Finding] = []
    for found in _run(cases, given.jobs):
        findings += found
        wrong = [item for item in found if item.verdict == WRONG]
        before = sum(item.verdict == WRONG for item in findings) - len(wrong)
        for item in wrong[: max(SHOWN - before, 0)]:
            print(f"\r{text_of(item)}")
        _progress(findings, len(cases), began)
    if len(cases) <= SHOWN:
        for item in findings:
            print(text_of(item))
    for direction in directions:
        print(f"\n{direction}: {' / '.join(VERDICTS)}\n\n{table(findings, direction)}")
    if given.out is not None:
        _write(findings, directions, given, time.monotonic() - began)
    return 1 if any(found.verdict == WRONG for found in findings) else 0


def _run(cases: Sequence[Case], jobs: int) -> Iterable[list[Finding]]:
    if jobs == 1 or len(cases) <= CHUNK:
        yield from map(run_chunk, chunks(cases))
        return
    with multiprocessing.get_context("spawn").Pool(jobs) as pool:
        yield from pool.imap_unordered(run_chunk, chunks(cases))


def _progress(findings: Sequence[Finding], total: int, began: float) -> None:
    done, elapsed = len(findings), time.monotonic() - began
    if not (sys.stdout.isatty() or done == total or done % (20 * CHUNK) < CHUNK):
        return
    counts = collections.Counter(found.verdict for found in findings)
    told = ", ".join(f"{counts[verdict]} {verdict}" for verdict in (HARMLESS, REPORTED, STOPPED, WRONG))
    left = elapsed / done * (total - done)
    end = "" if sys.stdout.isatty() and done < total else "\n"
    print(f"\r{done} of {total} runs: {told}; {elapsed:.0f} s, {left:.0f} s to go ", end=end, flush=True)


def _write(findings: list[Finding], directions: Sequence[str], given: Any, elapsed_s: float) -> None:
    given.out.mkdir(parents=True, exist_ok=True)
    findings.sort(key=lambda found: (found.direction, found.seed))
    content = {
        "seeds": [given.seeds.start, given.seeds.stop],
        "elapsed_s": round(elapsed_s, 1),
        "counts": {
            direction: collections.Counter(found.verdict for found in findings if found.direction == direction)
            for direction in directions
        },
        "findings": [dataclasses.asdict(found) for found in findings if found.verdict != HARMLESS],
    }
    (given.out / "findings.json").write_text(json.dumps(content, indent=1) + "\n")
    tables = [f"{direction}: {' / '.join(VERDICTS)}\n\n{table(findings, direction)}\n" for direction in directions]
    (given.out / "table.md").write_text("\n".join(tables))


if __name__ == "__main__":
    raise SystemExit(main())
