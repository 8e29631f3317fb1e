"""Time that a silent process is excused, and the ends of the limits."""

from __future__ import annotations

import dataclasses

import pytest

from gantry_driver.core.guard.silence import LATE_S, LOOK_S, TURN_S, SilenceWatch, ThreadSample


def sample(runnable: bool = True, cpu_ns: int = 5, waited_ns: int = 0) -> ThreadSample:
    return ThreadSample(runnable=runnable, cpu_ns=cpu_ns, waited_ns=waited_ns)


def test_the_limits_are_those_that_the_decision_explains() -> None:
    assert (LATE_S, LOOK_S, TURN_S) == (0.5, 0.04, 0.05)


def test_a_sample_has_waited_for_nothing_yet_and_cannot_change() -> None:
    fresh = ThreadSample(runnable=True, cpu_ns=5)
    assert fresh.waited_ns == 0
    with pytest.raises(dataclasses.FrozenInstanceError):
        fresh.cpu_ns = 6  # type: ignore[misc]


@pytest.mark.parametrize(
    ("before", "after", "waited_s"),
    [
        (sample(), sample(), 0.02),  # it could run, and did not: it waits yet
        (sample(cpu_ns=int("5000000000")), sample(cpu_ns=int("5000000000")), 0.02),
        (sample(), sample(runnable=False), 0.0),
        (sample(), sample(cpu_ns=6), 0.0),  # it ran
        (sample(cpu_ns=6), sample(cpu_ns=5), 0.0),  # another thread of the same number
        (sample(), sample(cpu_ns=6, waited_ns=5_000_000), 0.005),
        (sample(), sample(runnable=False, waited_ns=5_000_000), 0.005),
        (sample(waited_ns=4_000_000), sample(cpu_ns=6, waited_ns=5_000_000), 0.001),
        (sample(), sample(cpu_ns=6, waited_ns=900_000_000), 0.02),  # no more than the time that has passed
    ],
)
def test_the_time_that_a_thread_waited_for_the_processor(
    before: ThreadSample, after: ThreadSample, waited_s: float
) -> None:
    assert after.waited_s(before, 0.02) == pytest.approx(waited_s)


def test_silence_is_counted_from_the_start_and_from_each_beat() -> None:
    watch = SilenceWatch(0.1, 10.0)
    assert watch.silent_s == 0.0 and not watch.wants_sample
    watch.look(10.03)
    assert watch.silent_s == pytest.approx(0.03)
    watch.beat(10.04)
    assert watch.silent_s == 0.0
    watch.look(10.05)
    assert watch.silent_s == pytest.approx(0.01)


def test_a_sample_is_wanted_from_the_limit_of_a_look_on() -> None:
    watch = SilenceWatch(0.1, 0.0)
    watch.look(0.039)
    assert not watch.wants_sample
    watch.beat(0.0)
    watch.look(LOOK_S)
    assert watch.silent_s == LOOK_S and watch.wants_sample


@pytest.mark.parametrize(("limit_s", "late_s"), [(0.125, 0.5), (0.125, 0.125)])
def test_silence_as_long_as_the_limit_is_not_too_long(limit_s: float, late_s: float) -> None:
    watch = SilenceWatch(limit_s, 0.0, late_s)
    for count in range(1, 5):
        assert not watch.look(0.03125 * count)
    assert watch.silent_s == limit_s and watch.look(0.1251)


def test_the_bound_of_excuses_is_half_a_second_unless_it_is_given() -> None:
    watch, waits = SilenceWatch(0.1, 0.0), {1: sample()}
    for count in range(1, 17):
        assert not watch.look(0.03125 * count, waits)
    assert watch.silent_s == 0.5 and watch.look(0.5001, waits)


def test_the_thread_that_waited_longest_excuses_its_process_and_a_new_thread_does_not() -> None:
    watch = SilenceWatch(0.02, 0.0)
    watch.look(0.01, {1: sample(cpu_ns=1), 2: sample(cpu_ns=1)})
    later = {1: sample(cpu_ns=2, waited_ns=2_000_000), 2: sample(cpu_ns=2, waited_ns=8_000_000), 3: sample()}
    assert not watch.look(0.0279, later), "8 of 27.9 ms are excused"
    assert watch.look(0.0281, {2: sample(cpu_ns=3, waited_ns=8_000_000)})


def test_what_was_excused_and_sampled_before_a_beat_is_forgotten() -> None:
    watch = SilenceWatch(0.1, 0.0)
    for count in range(1, 11):
        watch.look(0.03 * count, {1: sample()})
    watch.beat(0.3)
    assert not watch.look(0.35, {1: sample()}), "the first sample after a beat compares with nothing"
    assert not watch.look(0.4, {1: sample(runnable=False)})
    assert watch.look(0.401, {1: sample(runnable=False)})


def test_a_look_without_threads_keeps_the_last_sample() -> None:
    watch = SilenceWatch(0.1, 0.0)
    watch.look(0.04, {1: sample()})
    watch.look(0.08, None)
    assert not watch.look(0.12, {1: sample()}), "0.04 of 0.12 s are excused"
