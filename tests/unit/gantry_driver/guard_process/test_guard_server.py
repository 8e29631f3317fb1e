"""The guard in one process with its test: each turn of its loop, and each end of a connection."""

from __future__ import annotations

import os
from collections.abc import Callable

import pytest
from support.deadlines import wait_until
from unit.gantry_driver.guard_rig import NotedLink, Rig, pressing

from gantry_driver.adapters.guard import server as server_module
from gantry_driver.adapters.guard.places import stylus_path
from gantry_driver.adapters.guard.server import ENDED, FLOOD_FRAMES, FLOODS, IN_USE, LINGER_S, UNSENT_BYTES
from gantry_driver.core.configuration.machine_config import DriverConfig
from gantry_driver.core.guard.messages import FrameReader, frame
from gantry_driver.core.machine.machine import Machine
from gantry_driver.core.states.machine_states import Note, Position, StateChanged
from gantry_driver.core.states.reasons import Reason
from icu_common.adapters.direct_stop.line import send_stop
from icu_common.core.reasons.codes import DriverCode
from icu_common.core.reasons.message import decoded, encoded

pytestmark = pytest.mark.slow


def test_a_node_gets_the_machine_s_state_and_its_answers(make: Callable[..., Rig]) -> None:
    rig = make()
    node = rig.node()
    rig.turn()
    rig.hello(node)
    node.sendall(frame({"do": "home", "id": 7}) + frame({"do": "heartbeat", "age_s": 0.0}))
    rig.turn()
    messages = rig.received(node)
    (answer,) = (m for m in messages if "id" in m)
    assert answer["id"] == 7 and decoded(answer["value"]).startswith("the driver is disconnected")


def test_a_second_node_is_refused_and_the_first_one_served(make: Callable[..., Rig]) -> None:
    rig = make()
    first = rig.node()
    rig.turn()
    rig.hello(first)
    second = rig.node()
    rig.turn()
    assert rig.received(second) == [{"refused": encoded(IN_USE)}, {"end": True}]
    assert {"end": True} not in rig.received(first)


def test_a_second_node_that_has_gone_already_does_no_harm(make: Callable[..., Rig]) -> None:
    rig = make()
    rig.node()
    rig.turn()
    rig.node().close()
    rig.turn()
    assert rig.guard._node is not None


def test_a_connection_that_is_gone_before_it_is_accepted_is_none(make: Callable[..., Rig]) -> None:
    rig = make()
    rig.guard._accept()
    assert rig.guard._node is None


def test_the_successor_of_a_node_that_hangs_is_accepted_and_the_machine_stopped(make: Callable[..., Rig]) -> None:
    rig = make()
    first = rig.node()
    rig.turn()
    link = pressing(rig)
    rig.guard._hung = True
    rig.node()
    rig.turn()
    assert link.stops == [ENDED] and not rig.guard._hung
    assert rig.received(first)[-1] == {"end": True}


@pytest.mark.parametrize("how", ["closed", "reset"])
def test_a_node_that_ends_while_the_machine_presses_stops_it(make: Callable[..., Rig], how: str) -> None:
    rig = make()
    node = rig.node()
    rig.turn()
    link = pressing(rig)
    if how == "reset":  # it ends with unread bytes
        rig.guard._send(frame({"turn": [1, 0, 0]}))
    node.close()
    rig.turn()
    assert link.stops == [ENDED] and rig.guard._node is None


def test_a_node_that_ends_at_rest_stops_nothing(make: Callable[..., Rig]) -> None:
    rig = make()
    rig.node().close()
    rig.turn(2)
    assert rig.guard._node is None and rig.guard._link is None


def test_nothing_to_read_is_no_end(make: Callable[..., Rig]) -> None:
    rig = make()
    rig.node()
    rig.turn()
    rig.guard._read()
    assert rig.guard._node is not None


def test_too_many_frames_are_a_fault_of_the_node(make: Callable[..., Rig]) -> None:
    rig = make()
    node = rig.node()
    rig.turn()
    link = pressing(rig)
    node.sendall((FLOOD_FRAMES + 1) * frame({"do": "beat"}))
    rig.turn(4)
    assert link.stops == [FLOODS] and rig.guard._node is None


def test_as_many_frames_as_allowed_are_none(make: Callable[..., Rig]) -> None:
    rig = make()
    node = rig.node()
    rig.turn()
    link = pressing(rig)
    node.sendall(FLOOD_FRAMES * frame({"do": "beat"}))
    rig.turn(4)
    assert link.stops == [] and rig.guard._node is not None


def test_too_many_bytes_are_a_fault_of_the_node(make: Callable[..., Rig], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server_module, "FLOOD_BYTES", 100)
    rig = make()
    node = rig.node()
    rig.turn()
    link = pressing(rig)
    node.sendall(frame({"do": "beat", "text": 100 * "x"}))
    rig.turn(2)
    assert link.stops == [FLOODS]


def test_the_count_of_frames_begins_again(make: Callable[..., Rig], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server_module, "FLOOD_S", -1.0)
    rig = make()
    node = rig.node()
    rig.turn()
    for _ in range(2):
        node.sendall((FLOOD_FRAMES - 1) * frame({"do": "beat"}))
        rig.turn(4)
    assert rig.guard._node is not None


@pytest.mark.parametrize(
    ("data", "reason"),
    [(frame({"do": "home"}), "before hello"), (frame({"do": "?"}), "before hello"), (frame({}), "KeyError")],
)
def test_an_unreadable_message_ends_the_connection(make: Callable[..., Rig], data: bytes, reason: str) -> None:
    rig = make()
    node = rig.node()
    rig.turn()
    node.sendall(data)
    rig.turn(2)
    assert rig.received(node)[-1] == {"end": True} and rig.guard._node is None
    link = pressing(rig)
    other = rig.node()
    rig.turn()
    other.sendall(frame({"do": "nothing"}))
    rig.turn(2)
    assert link.stops[0].startswith("the driver's node sent an unreadable message")


def test_a_stop_of_the_node_and_a_datagram_reach_the_link(make: Callable[..., Rig]) -> None:
    rig = make()
    node = rig.node()
    rig.turn()
    assert rig.guard._stops is None
    rig.hello(node)
    rig.guard._link.close("replaced by one that notes")  # type: ignore[union-attr]
    link = pressing(rig)
    node.sendall(frame({"do": "stop", "reason": "a person", "code": "driver.stop_requested"}))
    node.sendall(frame({"do": "stop", "reason": "a node without codes"}))
    assert send_stop(rig.folder / "stop", "the page") and send_stop(rig.folder / "stop", "again")
    rig.turn()
    # A stop that bypasses the graph is always a requested one.
    requested = [Reason(code=DriverCode.STOP_REQUESTED, text=text) for text in ("the page", "again", "a person")]
    assert link.stops == [*requested, "a node without codes"]
    rig.guard._link = None
    assert send_stop(rig.folder / "stop", "nothing is there to stop")
    rig.turn()


@pytest.mark.parametrize(("left", "down"), [("down\n", True), ("up\n", False), (None, False), ("", True)])
def test_a_killed_guard_s_record_is_read_where_no_file_is_configured(
    make: Callable[..., Rig], left: str | None, down: bool
) -> None:
    rig = make()
    record = stylus_path(str(rig.folder / "none"))
    try:
        if left is not None:
            record.write_text(left)
        node = rig.node()
        rig.turn()
        rig.hello(node)
        assert rig.guard._machine is not None and rig.guard._machine.may_be_down is down
        rig.guard._close("the driver is ending")
        assert record.exists() is down, "it stays until the stylus is known to be up"
    finally:
        record.unlink(missing_ok=True)


def test_a_configured_record_stays_where_it_is(make: Callable[..., Rig]) -> None:
    rig = make()
    file = rig.folder / "stylus"
    file.write_text("up\n")
    node = rig.node()
    rig.turn()
    rig.hello(node, config=DriverConfig(port=str(rig.folder / "none"), stylus_file=str(file)))
    rig.guard._close("the driver is ending")
    assert file.read_text() == "up\n" and not stylus_path(str(rig.folder / "none")).exists()


def test_another_stop_path_replaces_the_first_and_the_same_one_stays(make: Callable[..., Rig]) -> None:
    rig = make()
    node = rig.node()
    rig.turn()
    rig.hello(node)
    socket_before = rig.guard._stops
    rig.hello(node)
    assert rig.guard._stops is socket_before
    rig.hello(node, stop="other")
    assert send_stop(rig.folder / "other", "x") and rig.guard._stops is not socket_before


def test_another_port_makes_another_link_and_other_values_do_not(make: Callable[..., Rig]) -> None:
    rig = make()
    node = rig.node()
    rig.turn()
    rig.hello(node)
    first = rig.guard._link
    rig.hello(node, config=DriverConfig(port=str(rig.folder / "none"), feed_m_s=0.01), enabled=False)
    assert rig.guard._link is first and rig.guard._machine is not None
    assert rig.guard._machine.config.feed_m_s == 0.01 and not rig.guard._machine.enabled
    rig.hello(node, config=DriverConfig(port=str(rig.folder / "another")))
    assert rig.guard._link is not first and first is not None and not first.alive


def test_a_new_node_gets_what_was_kept(make: Callable[..., Rig]) -> None:
    rig = make()
    node = rig.node()
    rig.turn()
    rig.hello(node)
    node.close()
    rig.turn()
    rig.guard._on_events([Note(level="warn", text="kept"), Position(reading_m=(1.0, 2.0, 3.0))])
    other = rig.node()
    rig.turn()
    rig.hello(other)
    events = [event for message in rig.received(other) for event in message.get("events", [])]
    assert [content["text"] for name, content in events if name == "Note"] == ["kept"]
    assert not [name for name, _ in events if name == "Position"], "a position of the past is not kept"


def test_a_snapshot_has_the_position_if_it_is_known() -> None:
    machine = Machine(DriverConfig())
    assert server_module._snapshot(machine) == [StateChanged(text="disconnected: not opened yet")]
    machine.reading_m = (0.1, 0.2, 0.3)
    assert server_module._snapshot(machine)[1:] == [Position(reading_m=(0.1, 0.2, 0.3))]


@pytest.mark.parametrize("stays", [True, False])
def test_an_ordered_end_is_answered(make: Callable[..., Rig], stays: bool) -> None:
    rig = make(stays=stays)
    node = rig.node()
    rig.turn()
    rig.hello(node)
    node.sendall(frame({"do": "close", "reason": "the driver is ending"}))
    poller = server_module.select.poll()
    poller.register(rig.guard._node, server_module.select.POLLIN)
    rig.guard._turn(dict(poller.poll(50.0)))
    node.setblocking(False)
    assert {"closed": True} in list(FrameReader().feed(node.recv(65536)))
    assert rig.guard._ends is not stays and not (rig.folder / "stop").exists()


def test_a_signal_and_a_dead_link_end_the_guard(make: Callable[..., Rig]) -> None:
    rig = make()
    link = pressing(rig)
    link.alive = False
    rig.turn()
    assert rig.guard._ends
    rig.guard._ends = False
    link.alive = True
    os.write(rig.wake_write, b"\x0f")
    rig.guard.run()
    assert rig.guard._ends and link.closed == "the guard is ending"


@pytest.mark.parametrize(
    ("stays", "at_rest", "ends"), [(False, True, True), (True, True, False), (False, False, False)]
)
def test_a_guard_without_a_node_ends_after_a_while_unless_the_machine_moves(
    make: Callable[..., Rig], stays: bool, at_rest: bool, ends: bool
) -> None:
    rig = make(stays=stays)
    pressing(rig)
    rig.guard._machine.at_rest = at_rest  # type: ignore[union-attr,misc]
    rig.guard._alone_since -= LINGER_S + 0.1
    rig.turn()
    assert rig.guard._ends is ends


def test_a_guard_that_never_had_a_node_ends_too(make: Callable[..., Rig]) -> None:
    rig = make()
    rig.turn()
    assert not rig.guard._ends
    rig.guard._alone_since -= LINGER_S + 0.1
    rig.turn()
    assert rig.guard._ends


def test_a_silent_node_is_a_stop_once_and_its_next_message_ends_the_doubt(
    make: Callable[..., Rig], monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = make()
    node = rig.node()
    rig.turn()
    link = pressing(rig)
    now = [server_module.steady_s()]
    monkeypatch.setattr(server_module, "steady_s", lambda: now[0])
    monkeypatch.setattr(server_module, "sample_threads", lambda process: {})
    rig.guard._watch = server_module.SilenceWatch(0.1, now[0])
    for _ in range(6):
        now[0] += 0.04
        rig.guard._look()
    assert len(link.stops) == 1 and link.stops[0].startswith("the driver's node has been silent for 0.1")
    assert rig.guard._hung
    node.sendall(frame({"do": "beat"}))
    rig.guard._read()
    assert not rig.guard._hung


def test_a_simulation_without_a_node_is_polled(make: Callable[..., Rig], monkeypatch: pytest.MonkeyPatch) -> None:
    rig = make()
    link = pressing(rig)
    monkeypatch.setattr(type(rig.guard._clock), "wants_turns", property(lambda clock: True))
    rig.guard._look()
    assert link.wakes == 1 and rig.guard._steps_counted == 1


def test_a_step_of_the_node_sets_the_clock_and_wakes_the_link(make: Callable[..., Rig]) -> None:
    rig = make()
    node = rig.node()
    rig.turn()
    rig.guard._clock.begin(1.0)
    link = pressing(rig)
    node.sendall(frame({"do": "step", "time_s": 5.0}))
    rig.turn()
    assert link.wakes == 1 and rig.guard._clock() == 5.0


def test_turns_are_counted_once_and_only_for_a_node(make: Callable[..., Rig]) -> None:
    rig = make()
    rig.guard._on_turn(3, 0, 0)
    node = rig.node()
    rig.turn()
    rig.guard._on_turn(5, 10, 20)
    rig.guard._on_turn(5, 0, 0)
    assert [m["turn"] for m in rig.received(node) if "turn" in m] == [[2, 10, 20]]
    rig.guard._clock.begin(1.0)
    rig.guard._clock.leave()
    rig.guard._on_turn(5, 10, 20)
    assert [m for m in rig.received(node) if "turn" in m] == [], "a clock without its node counts by itself"


def test_what_a_node_does_not_read_is_kept_up_to_a_bound(make: Callable[..., Rig]) -> None:
    rig = make()
    node = rig.node()
    rig.turn()
    rig.guard._send((UNSENT_BYTES // 2) * b"x")
    assert rig.guard._unsent and rig.guard._descriptors()[rig.guard._node.fileno()] & server_module.select.POLLOUT  # type: ignore[union-attr]
    for _ in range(4):
        rig.guard._send((UNSENT_BYTES // 2) * b"x")
    rig.turn()
    assert rig.guard._node is None
    node.close()


def test_bytes_for_a_node_that_has_gone_are_dropped(make: Callable[..., Rig]) -> None:
    rig = make()
    rig.guard._send(b"without a node")
    node = rig.node()
    rig.turn()
    node.close()
    rig.guard._send(b"x")
    rig.guard._send(b"x")
    assert not rig.guard._unsent


def test_closing_twice_and_a_stop_file_that_has_gone_do_no_harm(make: Callable[..., Rig]) -> None:
    rig = make()
    node = rig.node()
    rig.turn()
    rig.hello(node)
    (rig.folder / "stop").unlink()
    rig.guard._close("first")
    rig.guard._close("second")
    assert rig.guard._link is None and rig.guard._stops is None


class StoppingLink(NotedLink):
    """Needs some time of the guard's clock to stop its machine, as the machine itself does."""

    def __init__(self, clock: Callable[[], float]) -> None:
        super().__init__()
        self._clock = clock

    def close(self, reason: str) -> None:
        super().close(reason)
        begin_s = self._clock()
        wait_until(lambda: self._clock() > begin_s + 0.01, "time passes while the machine stops", 5.0)


@pytest.mark.parametrize("message", ["close", "hello"])
def test_simulated_time_passes_while_a_link_stops_its_machine(make: Callable[..., Rig], message: str) -> None:
    rig = make()
    node = rig.node()
    rig.turn()
    rig.hello(node, time_s=12.5)
    assert rig.guard._link is not None
    rig.guard._link.close("the test gives it another one")
    link = StoppingLink(rig.guard._clock)
    rig.guard._link = link  # type: ignore[assignment]
    if message == "close":
        node.sendall(frame({"do": "close", "reason": "the driver is ending"}))
        assert {"closed": True} in rig.received(node) and link.closed == "the driver is ending"
    else:
        rig.hello(node, time_s=12.5, config=DriverConfig(port=str(rig.folder / "other")))
        assert link.closed == "another configuration"
        begin_s = rig.guard._clock()
        assert begin_s > 12.5 and rig.guard._clock() == begin_s, "it follows the node's steps again"
