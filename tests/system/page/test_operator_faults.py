"""Faults while the machine moves, in a real browser with the true driver: it halts within 800 ms and says why."""

from __future__ import annotations

import contextlib
import signal
import subprocess
import time
from collections.abc import Iterator
from typing import Any

import pytest
from support.ros_rig import domain_of_worker
from system.machine_rig import MachineRig
from system.operator_browser import Operator

HALT_S = 0.8
pytestmark = [pytest.mark.browser, pytest.mark.system, pytest.mark.alone, pytest.mark.timeout(300), pytest.mark.long]


class Room:
    """The rig with an operator, whose page comes by the link, and a witness in addition."""

    def __init__(self, rig: MachineRig, browser: Any) -> None:
        self.rig, self.browser = rig, browser
        self.operator = Operator(browser, rig.by_link(rig.address()))
        self.witness = self.looks_on()
        page = self.operator.page
        page.click("#lease-take")
        self.operator.sees("#lease-text", "You are in control")
        self.operator.sees("#chip-driver", "Not homed", within_s=20.0)
        page.click("[data-call=enable]")
        for _ in range(3):
            page.click("[data-call=home]")
            page.click("[data-call=home]")
            self.operator.sees("#chip-driver", "Homing")
            if "Idle" in self.operator.sees("#chip-driver", "Idle|Stopped", within_s=60.0):
                break
            # A machine so loaded that the page was late is stopped, as it should be; a person goes on.
            print(page.inner_text("#banner"))
            self.resets(then="Not homed|Idle")
        page.click("#tab-move")

    def looks_on(self) -> Operator:
        """Return a second person, whose page speaks German."""
        return Operator(self.browser, self.rig.new_address(), locale="de-DE")

    def moves(self) -> int:
        """Begin a long move; return the board's log number and the time at which it is in progress."""
        operator = self.operator
        operator.until(lambda: operator.page.is_enabled("#go"), 10.0, lambda: operator.page.inner_text("#move-why"))
        far = float(operator.sees("#position-x", r"\d").split()[0]) < 170  # one that is not reported is a dash
        operator.page.fill("#go-x", "340" if far else "10")
        operator.page.fill("#go-y", "20")
        operator.insists(lambda: operator.page.click("#go"))
        operator.sees("#chip-driver", "Moving")
        return self.rig.board.mark()

    def resets(self, then: str = "Idle") -> None:
        """Go on as a person would: take control if it was lost, reset."""
        operator = self.operator
        operator.sees("#chip-driver", "Stopped", within_s=10.0)
        operator.until(
            lambda: not operator.page.is_hidden("#lease-take") or operator.page.is_enabled("#reset"),
            10.0,
            lambda: operator.page.inner_text("#lease-text"),
        )
        if not operator.page.is_hidden("#lease-take"):
            operator.page.click("#lease-take")
        operator.until(lambda: operator.page.is_enabled("#reset"), 15.0, lambda: "reset can be pressed")
        operator.page.click("#reset")
        operator.sees("#chip-driver", then, within_s=10.0)


@pytest.fixture(scope="module")
def prepared(browser: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Room]:
    rig = MachineRig(tmp_path_factory.mktemp("machine"), domain=domain_of_worker(90, 10))
    try:
        yield Room(rig, browser)
    finally:
        rig.close()


@pytest.fixture
def room(prepared: Room) -> Room:
    # A test that failed must not fail the next.
    if "Stopped" in prepared.operator.sees("#chip-driver", "Stopped|Idle|Alarm", within_s=10.0):
        prepared.resets()
    return prepared


@contextlib.contextmanager
def standing_still(process: subprocess.Popen[bytes]) -> Iterator[None]:
    process.send_signal(signal.SIGSTOP)
    try:
        yield
    finally:
        process.send_signal(signal.SIGCONT)


def check(name: str, begin_s: float, halted_s: float) -> None:
    print(f"{name}: halted after {1e3 * (halted_s - begin_s):.0f} ms")
    assert 0 <= halted_s - begin_s < HALT_S


def test_stop(room: Room) -> None:
    since = room.moves()
    begin = time.monotonic()
    room.operator.page.keyboard.press("Escape")
    check("Escape", begin, room.rig.halted_s(since))
    room.operator.sees("#banner", "STOPPED – STOP was pressed by Operator 1")
    room.witness.sees("#banner", "GESTOPPT – Operator 1 hat STOP gedrückt")
    room.resets()


def test_the_page_freezes(room: Room) -> None:
    since = room.moves()
    begin = time.monotonic()
    room.operator.page.evaluate(
        "() => { setTimeout(() => { const t = performance.now(); while (performance.now() - t < 1500); }) }"
    )
    check("page frozen", begin, room.rig.halted_s(since))
    row = room.witness.logs("STOP.*Seite des Bedieners antwortete nicht mehr", 5.0)
    assert "Watchdog" in row
    room.witness.sees("#banner", r"GESTOPPT – die Seite des Bedieners antwortete nicht.*0,\d s lang nichts")
    room.operator.sees("#banner", "STOPPED – the operator’s page did not respond")
    room.operator.sees("#lease-text", "No operator has control")
    assert not room.operator.page.is_enabled("#reset"), "nothing resumes by itself"
    room.resets()


def test_the_tab_is_hidden(room: Room) -> None:
    """A hidden tab has no animation frames; a headless browser hides none, so the frames are taken away."""
    since = room.moves()
    begin = time.monotonic()
    room.operator.page.evaluate(
        """() => { const frame = window.requestAnimationFrame; const waiting = [];
            window.requestAnimationFrame = (f) => waiting.push(f);
            window.show = () => { window.requestAnimationFrame = frame; waiting.forEach((f) => frame(f)); }; }"""
    )
    check("no animation frames", begin, room.rig.halted_s(since))
    room.witness.sees("#banner", "GESTOPPT – die Seite des Bedieners antwortete nicht")
    room.operator.page.evaluate("() => window.show()")
    room.resets()
    since = room.moves()
    begin = time.monotonic()
    room.operator.page.evaluate(
        """() => { Object.defineProperty(document, 'visibilityState', {value: 'hidden', configurable: true});
            document.dispatchEvent(new Event('visibilitychange')); delete document.visibilityState; }"""
    )
    check("tab hidden, which it says", begin, room.rig.halted_s(since))
    room.operator.sees("#banner", "STOPPED – the operator’s page was hidden")
    room.witness.sees("#banner", "GESTOPPT – die Seite des Bedieners war verdeckt")
    room.resets()


def test_the_link_is_cut(room: Room) -> None:
    since = room.moves()
    begin = time.monotonic()
    room.rig.link.cut()
    check("link cut", begin, room.rig.halted_s(since))
    room.witness.sees("#banner", "GESTOPPT – die Verbindung zur Seite des Bedieners ist abgerissen")
    room.operator.sees("#banner", "No link to the bridge", within_s=5.0)
    room.operator.sees("#chip-link", "LOST")
    room.rig.link.mend()
    room.operator.sees("#chip-link", r"\d ms", within_s=10.0)
    room.operator.sees("#banner", "STOPPED – the bridge lost its link to the operator’s page")
    room.resets()


def test_the_camera_stalls(room: Room) -> None:
    since = room.moves()
    begin = time.monotonic()
    with standing_still(room.rig.camera):
        check("camera stalled", begin, room.rig.halted_s(since))
        room.operator.logs("STOP.*the camera sent no image during a motion", 5.0)
        room.operator.sees("#banner", r"STOPPED – no camera picture came.*nothing for 0\.\d s")
        room.witness.sees("#banner", "GESTOPPT – während einer Bewegung kam kein Kamerabild")
        room.operator.sees("#stale", "STALE")
        assert not room.operator.page.is_enabled("#go")
    room.resets()


def test_the_server_hangs(room: Room) -> None:
    since = room.moves()
    begin = time.monotonic()
    with standing_still(room.rig.bridge):
        check("server stopped", begin, room.rig.halted_s(since))
        room.operator.sees("#banner", "No link to the bridge", within_s=5.0)
    room.operator.sees("#banner", "STOPPED.*heartbeat", within_s=10.0)
    room.resets()


def test_the_server_is_killed(room: Room) -> None:
    since = room.moves()
    begin = time.monotonic()
    room.rig.bridge.kill()
    check("server killed", begin, room.rig.halted_s(since))
    room.operator.sees("#banner", "No link to the bridge", within_s=5.0)
    room.rig.bridge.wait()
    room.rig.start_bridge()
    room.rig.address()
    room.operator.page.wait_for_selector("#token", timeout=20_000)
    room.operator.page.fill("#token", (room.rig.folder / "token").read_text())
    room.operator.page.press("#token", "Enter")  # the other form is hidden by a style that may come later
    room.witness = room.looks_on()
    room.operator.sees("#banner", "STOPPED.*heartbeat", within_s=10.0)
    room.resets()
    room.operator.page.click("#tab-move")


def test_the_board_raises_an_alarm(room: Room) -> None:
    room.moves()
    begin = time.monotonic()
    room.rig.board.ask(do="fault", kind="alarm", number=1)
    room.operator.sees("#banner", "ALARM", within_s=HALT_S)
    print(f"alarm: on the page after {1e3 * (time.monotonic() - begin):.0f} ms")
    state = room.rig.board.ask(do="state")
    assert state["state"].startswith("Alarm")
    room.witness.sees("#chip-driver", "Alarm")
    assert not room.operator.page.is_enabled("#go")


def test_nobody_complained(room: Room) -> None:
    room.operator.leaves()
    room.witness.leaves()
