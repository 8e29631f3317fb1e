"""Pairing by stamps: exact and approximate, late, lost and repeated items."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from harris_perception.core.stereo.pairing import Pairing


def test_equal_stamps_meet_whatever_the_order_of_the_streams() -> None:
    pairing = Pairing(3)
    assert pairing.add(1, 10, "b") is None
    assert pairing.add(0, 10, "a") is None
    assert pairing.add(2, 10, "c") == ("a", "b", "c")
    assert pairing.unpaired == 0


def test_slow_streams_meet_their_own_moment_although_newer_items_wait() -> None:
    pairing = Pairing(2)
    for stamp in (10, 20, 30):
        assert pairing.add(0, stamp, f"image{stamp}") is None
    assert pairing.add(1, 20, "corners20") == ("image20", "corners20")
    assert pairing.unpaired == 1  # image10 was given up
    assert pairing.add(1, 30, "corners30") == ("image30", "corners30")


def test_near_stamps_meet_within_the_tolerance_only() -> None:
    pairing = Pairing(2, tolerance_ns=3)
    assert pairing.add(0, 100, "a") is None
    assert pairing.add(1, 104, "late") is None
    assert pairing.add(1, 97, "b") == ("a", "b")
    assert Pairing(2, tolerance_ns=0).add(1, 1, "x") is None


def test_an_exact_partner_is_preferred_to_a_near_one() -> None:
    pairing = Pairing(2, tolerance_ns=5)
    pairing._waiting[0][98] = "near"
    pairing._waiting[0][100] = "exact"
    assert pairing.add(1, 100, "b") == ("exact", "b")


def test_moments_are_thinned_by_their_stamps_also_of_a_recording_that_starts_anew() -> None:
    pairing, due = Pairing(1), []
    for stamp_ms in (1000, 1067, 1133, 1199, 1200, 1398, 100, 200, 301):
        pairing.add(0, stamp_ms * 1_000_000, "")
        due += [stamp_ms] if pairing.due(5.0) else []
    assert due == [1000, 1199, 1398, 100, 301]


@given(st.lists(st.tuples(st.integers(0, 2), st.integers(0, 40)), max_size=80))
def test_every_item_is_returned_once_given_up_or_waiting(arrivals: list[tuple[int, int]]) -> None:
    pairing = Pairing(3, tolerance_ns=1, depth=4)
    returned, repeated = 0, 0
    for stream, stamp in arrivals:
        repeated += stamp in pairing._waiting[stream]
        found = pairing.add(stream, stamp, (stream, stamp))
        if found is not None:
            returned += 3
            assert [item[0] for item in found] == [0, 1, 2]
            assert max(item[1] for item in found) - min(item[1] for item in found) <= 1
    left = sum(len(waiting) for waiting in pairing._waiting)
    assert left <= 12
    assert returned + pairing.unpaired + left + repeated == len(arrivals)


@pytest.mark.parametrize("phase_ms", [0.5, 13.0, 29.0, 40.0, 60.0])
def test_a_tolerance_of_half_a_period_pairs_free_running_cameras(phase_ms: float) -> None:
    """Two cameras at 15 Hz without a trigger: each left image gets the nearest right one, whatever the phase."""
    pairing, period_ns, found = Pairing(2, tolerance_ns=34_000_000), 66_666_667, []
    shots = [(n * period_ns, 0, n) for n in range(30)]
    shots += [(n * period_ns + round(phase_ms * 1e6), 1, n) for n in range(30)]
    for stamp_ns, stream, number in sorted(shots):
        if (pair := pairing.add(stream, stamp_ns, number)) is not None:
            found.append(pair)
    off = 0 if phase_ms < 33.4 else 1
    assert found == [(n + off, n) for n in range(30 - off)]
