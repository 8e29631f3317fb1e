"""The form of the pictures follows what the viewer's link can take."""

from __future__ import annotations

import heapq
from dataclasses import dataclass

import numpy as np
import pytest

from scope_ui_bridge.core.video import FORMS, FrameWindow

FULL_BYTES = 77_000
"""A picture of the bench at quality 80, 1280 x 720."""


@dataclass
class Link:
    """A viewer behind a line of ``bits_per_s`` (may change) and ``delay_s`` one way, simulated in virtual time."""

    bits_per_s: float
    delay_s: float
    drawing_s: float = 0.012
    period_s: float = 1 / 30

    def __post_init__(self) -> None:
        self.window = FrameWindow()
        self.now_s, self.free_s, self.next_s, self.seq = 0.0, 0.0, 0.0, 0
        self.acknowledgements: list[tuple[float, int]] = []

    def run(self, seconds: float) -> tuple[np.ndarray, np.ndarray]:
        """Return age when drawn (s) and level of each picture."""
        rows = []
        end_s = self.now_s + seconds
        while self.now_s < end_s:
            acknowledged_s = self.acknowledgements[0][0] if self.acknowledgements else np.inf
            if acknowledged_s <= self.next_s:
                self.now_s, number = heapq.heappop(self.acknowledgements)
                self.window.acknowledged(number, self.now_s)
            else:
                self.now_s, self.next_s, self.seq = self.next_s, self.next_s + self.period_s, self.seq + 1
            if self.seq and self.window.wants(self.seq):
                taken_s = (self.seq - 1) * self.period_s
                self.window.sent(self.seq, self.now_s)
                bits = 8 * FULL_BYTES * FORMS[self.window.level].size
                self.free_s = max(self.free_s, self.now_s) + bits / self.bits_per_s
                drawn_s = self.free_s + self.delay_s + self.drawing_s
                rows.append((drawn_s - taken_s, self.window.level))
                heapq.heappush(self.acknowledgements, (drawn_s + self.delay_s, self.seq))
        ages, levels = np.array(rows).T
        return ages, levels


def test_a_good_link_gets_the_full_form_always() -> None:
    _, levels = Link(100e6, 0.002).run(60.0)
    assert set(levels) == {0}


def test_3_mbit_and_20_ms_is_late_for_a_moment_only() -> None:
    link = Link(3e6, 0.020)
    link.run(2.0)
    ages, levels = link.run(120.0)
    assert np.percentile(ages, 95) < 0.15
    assert ages.max() < 0.2, "no heavier form is tried that the link cannot take"
    assert len(ages) / 120 > 8
    assert FORMS[round(float(np.median(levels)))].scale >= 0.5


@pytest.mark.parametrize("megabits", [1.5, 2.0, 4.0, 6.0, 8.0, 12.0])
def test_other_links_settle_below_200_ms(megabits: float) -> None:
    link = Link(1e6 * megabits, 0.020)
    link.run(2.0)
    ages, levels = link.run(120.0)
    print(f"{megabits} Mbit/s: p95 {1e3 * np.percentile(ages, 95):.0f} ms, {len(ages) / 120:.1f} pictures per second")
    assert np.percentile(ages, 95) < 0.2
    assert np.count_nonzero(np.diff(levels)) < 60, "no flutter"


def test_a_link_that_becomes_slow_is_followed_within_two_seconds_and_back_when_it_is_fast_again() -> None:
    link = Link(50e6, 0.005)
    link.run(10.0)
    link.bits_per_s = 1.5e6
    link.run(2.0)
    ages, _ = link.run(10.0)
    assert np.percentile(ages, 95) < 0.2
    link.bits_per_s = 50e6
    link.run(15.0)
    assert link.window.level == 0


def test_one_hiccup_changes_nothing() -> None:
    link = Link(50e6, 0.005)
    link.run(1.0)
    link.free_s = link.now_s + 0.4
    link.run(1.0)
    assert link.window.level == 0


def test_failed_tries_become_rare() -> None:
    """A viewer whose drawing, not whose link, is slow for everything but the lightest form."""
    window, now_s, tries = FrameWindow(), 0.0, []
    for seq in range(20_000):
        flight_s = 0.05 if window.level == len(FORMS) - 1 else 0.15 * (2 if window.level == 0 else 1)
        before = window.level
        window.sent(seq, now_s)
        now_s += flight_s
        window.acknowledged(seq, now_s)
        if window.level < before:
            tries.append(now_s)
    apart = np.diff(tries)
    assert list(np.round(apart)) == sorted(np.round(apart))
    assert apart.max() == pytest.approx(80, abs=2)


def test_at_most_two_pictures_are_under_way_and_none_is_sent_twice() -> None:
    window = FrameWindow()
    assert window.wants(1)
    window.sent(1, 0.0)
    assert not window.wants(1)
    assert window.wants(4)
    window.sent(4, 0.0)
    assert not window.wants(5), "two are under way"
    window.acknowledged(77, 0.1)
    assert not window.open, "a number that was never sent settles nothing"
    window.acknowledged(4, 0.1)
    assert window.wants(5)
    window.acknowledged(1, 0.1)
    window.sent(5, 0.1)
    window.sent(6, 0.1)
    assert not window.open, "an old acknowledgement after a newer one settles nothing"
