"""Measure the operator page in a real browser with the real driver: delays, stop, many viewers.

The camera's images contain the time at which they were made, and the browser reads it from the canvas as soon as it is
drawn. So "glass to glass" is the time from the camera node's stamp to pixels on the page, without the monitor's own
delay. The slow link is a proxy with 3 Mbit/s and 20 ms one way in each direction. A stop is measured from the page's
key to ``!`` at the mock board. With many viewers, the benchmark also measures the regularity of the operator's
heartbeat, the age of corners on arrival (from a node on the same images), and the bridge's share of a processor: the
bridge has real-time scheduling, so no other program gets this share. ``--parts floods`` measures STOP while observers
and strangers flood the server. docs/decisions/operator-page.md compares other methods to show a camera on a page.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import aiohttp
import numpy as np

from icu_common.adapters.real_time import is_real_time

sys.path.append(str(Path(__file__).resolve().parents[1]))
sys.path.append(str(Path(__file__).resolve().parents[2] / "tests"))
from page.page_flood_times import floods, write_passwords
from rows import Row, bound, write
from system.barcode_camera import READER
from system.conftest import executable
from system.machine_rig import MachineRig
from system.operator_browser import OPTIONS, Operator, browser_program

SLOW = {"bits_per_s": 3e6, "delay_s": 0.020}
VIEWERS = 20
PARTS = ("delay", "floods", "stop", "crowd", "slow")


@contextmanager
def chromium() -> Iterator[Any]:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        running = playwright.chromium.launch(executable_path=browser_program(), args=OPTIONS)
        yield running
        running.close()


def ages(operator: Operator, seconds: float, warm_s: float = 3.0) -> tuple[np.ndarray, float]:
    """Return the age in ms of each new image, and images per second."""
    operator.page.wait_for_selector("#stage:not(.empty)")
    operator.page.evaluate(READER)
    operator.page.wait_for_timeout(1000 * warm_s)
    operator.page.evaluate("() => { window.ages.length = 0; }")
    operator.page.wait_for_timeout(1000 * seconds)
    found = np.array(operator.page.evaluate("() => window.ages"), float)
    return found, len(found) / seconds


def glass(name: str, operator: Operator, seconds: float, limit_ms: float) -> list[Row]:
    found, rate = ages(operator, seconds)
    p50, p95, p99 = np.percentile(found, [50, 95, 99])
    print(f"{name}: {len(found)} pictures, {rate:.1f} per second, p50 {p50:.0f}, p95 {p95:.0f}, p99 {p99:.0f} ms")
    return [
        bound(f"{name}: glass to glass p95 [ms]", float(p95), limit_ms),
        bound(f"{name}: pictures per second", rate, 5.0, at_least=True),
    ]


def round_trips(operator: Operator, count: int) -> list[Row]:
    """Measure the round trip of a command to the bridge and its answer, on the page's own connection."""
    took = operator.page.evaluate(
        """async (count) => {
            const { desk } = await import('/page/connection/desk.js');
            const took = [];
            for (let i = 0; i < count; i += 1) {
              const begin = performance.now();
              await desk.link.ask('select', desk.seen);
              took.push(performance.now() - begin);
              await new Promise((done) => setTimeout(done, 40));
            }
            return took; }""",
        count,
    )
    p50, p95 = np.percentile(took, [50, 95])
    print(f"command and answer: p50 {p50:.1f}, p95 {p95:.1f} ms of {count}")
    return [bound("command round trip p95 [ms]", float(p95), 50.0)]


def makes_ready(operator: Operator) -> None:
    """Take control, enable, home; make the page record the time of key presses."""
    page = operator.page
    page.click("#lease-take")
    operator.sees("#chip-driver", "Not homed", within_s=20.0)
    for name in ("enable", "home", "home"):
        page.click(f"[data-call={name}]")
    operator.sees("#chip-driver", "Idle", within_s=60.0)
    page.evaluate(
        """() => window.addEventListener('keydown', () => {
            window.pressed = performance.timeOrigin + performance.now(); }, true)"""
    )


def stops(rig: MachineRig, operator: Operator, count: int) -> list[Row]:
    """Stop repeatedly at rest: the driver sends its hold each time, in any state."""
    took = []
    page = operator.page
    for _ in range(count):
        since = rig.board.mark()
        # The page records the browser's clock at the key press, so playwright's delay to the browser is not included.
        page.keyboard.press("Escape")
        pressed_s = page.evaluate("() => window.pressed") / 1e3 - (time.time() - time.monotonic())
        took.append(1e3 * (rig.halted_s(since) - pressed_s))
        page.wait_for_timeout(600)  # a stop of the same person within half a second would count as the same stop
        operator.until(lambda: page.is_enabled("#reset"), 5.0, lambda: "reset can be pressed")
        page.click("#reset")
        operator.until(lambda: page.is_hidden("#reset"), 5.0, lambda: page.inner_text("#log"))
    p50, p99 = np.percentile(took, [50, 99])
    print(f"stop: {count} times, p50 {p50:.1f}, p99 {p99:.1f}, longest {max(took):.1f} ms")
    return [bound("stop by key to the driver's byte, p99 [ms]", float(p99), 50.0)]


def memory_mb(pid: int) -> float:
    status = Path(f"/proc/{pid}/status").read_text()
    return int(next(line for line in status.splitlines() if line.startswith("VmRSS")).split()[1]) / 1024


class Crowd:
    """Viewers without a browser: all but the last acknowledge each image; the last one stops reading."""

    def __init__(self, rig: MachineRig, count: int) -> None:
        self._ready = threading.Event()
        self._ended = threading.Event()
        self.pictures = 0
        self._cookies: list[tuple[str, str]] = []
        for _ in range(count):
            self._sign_in(rig.new_address())
        self._thread = threading.Thread(target=lambda: asyncio.run(self._look()), daemon=True)
        self._thread.start()
        self._ready.wait(20.0)

    def _sign_in(self, address: str) -> None:
        with urllib.request.urlopen(address, timeout=10.0) as answer:
            cookie = answer.headers["Set-Cookie"].partition(";")[0]
        self._cookies.append((address.partition("?")[0], cookie))

    async def _look(self) -> None:
        tasks = [asyncio.create_task(self._view(n, *cookie)) for n, cookie in enumerate(self._cookies)]
        self._ready.set()
        while not self._ended.is_set():
            await asyncio.sleep(0.1)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    async def _view(self, number: int, url: str, cookie: str) -> None:
        headers = {"Origin": url.rstrip("/"), "Cookie": cookie}
        stalled = number == len(self._cookies) - 1
        async with aiohttp.ClientSession(headers=headers) as session:
            control = await session.ws_connect(url + "control", max_msg_size=0)
            video = await session.ws_connect(url + "video", max_msg_size=0)
            await video.send_str(json.dumps({"camera": "left", "corners": True}))
            if stalled:
                await asyncio.Event().wait()
            drain = asyncio.create_task(self._drain(control))
            async for message in video:
                if message.type is aiohttp.WSMsgType.BINARY:
                    size = int.from_bytes(message.data[:4], "big")
                    await video.send_str(json.dumps({"drawn": json.loads(message.data[4 : 4 + size])["seq"]}))
                    self.pictures += 1
            drain.cancel()

    @staticmethod
    async def _drain(control: aiohttp.ClientWebSocketResponse) -> None:
        async for _ in control:
            pass

    def close(self) -> None:
        self._ended.set()
        self._thread.join(10.0)


def real_time_s(pid: int) -> float:
    """Return the processor time of a process's threads with real-time scheduling."""
    used = 0.0
    for thread in Path(f"/proc/{pid}/task").iterdir():
        if is_real_time(int(thread.name)):
            fields = (thread / "stat").read_text().rpartition(")")[2].split()
            used += (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    return used


class Beside:
    """The corners node on the camera's images, and a listener to its corners and the operator's heartbeat."""

    def __init__(self, rig: MachineRig) -> None:
        corners = executable("harris_perception", "corners")
        remapped = ["image_raw:=stereo/left/image_raw", "corners:=stereo/left/corners"]
        options = [text for one in remapped for text in ("-r", one)]
        environment = rig.graph.environment
        self._corners = subprocess.Popen([corners, "--ros-args", *options], env=environment)
        self._ear = subprocess.Popen(
            [sys.executable, str(Path(__file__).with_name("page_listener.py"))],
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def heard(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the ms between heartbeats and the ages of corners in ms, since the last call."""
        assert self._ear.stdin is not None and self._ear.stdout is not None
        self._ear.stdin.write("\n")
        self._ear.stdin.flush()
        beats, corners = json.loads(self._ear.stdout.readline())
        return np.diff(beats), np.array(corners)

    def close(self) -> None:
        assert self._ear.stdin is not None
        self._ear.stdin.close()
        self._corners.terminate()
        for process in (self._ear, self._corners):
            try:
                process.wait(10.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def crowd(rig: MachineRig, operator: Operator, seconds: float) -> list[Row]:
    if operator.page.is_visible("#lease-take"):
        operator.page.click("#lease-take")
    beside = Beside(rig)
    try:
        # On a computer's first run the node compiles for a minute or more.
        operator.until(lambda: len(beside.heard()[1]), 300.0, lambda: "corners come")
        alone, alone_rate = ages(operator, seconds / 2)
        before = memory_mb(rig.bridge.pid)
        viewers = Crowd(rig, VIEWERS)
        try:
            beside.heard()
            used_s, begin_s = real_time_s(rig.bridge.pid), time.monotonic()
            with_all, rate = ages(operator, seconds)
            share = (real_time_s(rig.bridge.pid) - used_s) / (time.monotonic() - begin_s)
            gaps, corners = beside.heard()
            after = memory_mb(rig.bridge.pid)
            operator.page.wait_for_timeout(500 * seconds)
            late = memory_mb(rig.bridge.pid)
        finally:
            viewers.close()
    finally:
        beside.close()
    print(f"{VIEWERS} viewers, one stalled: {alone_rate:.1f} -> {rate:.1f} pictures per second, p95")
    print(
        f"  {np.percentile(alone, 95):.0f} -> {np.percentile(with_all, 95):.0f} ms, {viewers.pictures} pictures to them"
    )
    print(f"  heartbeat: {len(gaps)} gaps, median {np.median(gaps):.0f}, longest {gaps.max():.0f} ms")
    print(f"  corners: {len(corners)}, age p50 {np.median(corners):.0f}, p95 {np.percentile(corners, 95):.0f} ms")
    print(f"  {100 * share:.0f} % of a processor with real-time scheduling")
    print(f"  memory {before:.0f} -> {after:.0f} -> {late:.0f} MB")
    return [
        bound(f"{VIEWERS} viewers, one stalled: share of the operator's rate", rate / alone_rate, 0.9, at_least=True),
        bound(f"{VIEWERS} viewers, one stalled: longest from heartbeat to heartbeat [ms]", float(gaps.max()), 400.0),
        bound(f"{VIEWERS} viewers, one stalled: growth of memory while they look [MB]", late - after, 5.0),
    ]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=10.0, help="length of each measurement (10)")
    parser.add_argument("--stops", type=int, default=60, help="how many stops (60)")
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=PARTS, help="only some of it (all)")
    given = parser.parse_args()
    rows: list[Row] = []
    with chromium() as browser, tempfile.TemporaryDirectory() as folder:
        write_passwords(Path(folder))
        rig = MachineRig(Path(folder), 90 + os.getpid() % 10, picture=render(Path(folder)), rate=30, **SLOW)
        try:
            operator = Operator(browser, rig.address())
            if "delay" in given.parts:
                rows += glass("loopback", operator, given.seconds, 60.0)
                rows += round_trips(operator, 100)
            if "floods" in given.parts:
                rows += floods(rig, given.stops // 2)
            if "stop" in given.parts:
                makes_ready(operator)
                rows += stops(rig, operator, given.stops)
            if "crowd" in given.parts:
                rows += crowd(rig, operator, given.seconds)
            operator.context.close()
            if "slow" in given.parts:
                slow = Operator(browser, rig.by_link(rig.new_address()))
                slow.page.wait_for_timeout(5000)
                rows += glass("3 Mbit/s, 20 ms one way", slow, given.seconds, 250.0)
                slow.context.close()
        finally:
            rig.close()
    busy = f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores"
    write("operator_page", rows, title=f"operator page ({busy})")
    return 0


def render(folder: Path) -> Path:
    """Return an image of the bench with a camera's detail and noise."""
    picture = folder / "bench.png"
    command = [sys.executable, "-m", "icu_simulator.cli.render", "--out", str(picture)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return picture


if __name__ == "__main__":
    raise SystemExit(main())
