"""JPEGs are made outside of the bridge, whose real-time scheduling is for the heartbeat and the orders."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.deadlines import wait_until
from unit.scope_ui_bridge.web_rig import WITHIN_S, Rig, page, until, with_rig

from scope_ui_bridge.adapters.video.jpeg_encoder import JpegEncoder, to_jpeg
from scope_ui_bridge.core.video import FORMS

SEED = 5
IN_REAL_TIME = """
import asyncio, json, os, pathlib, cv2
from icu_common.adapters.real_time import BRIDGE, ask_for_real_time
from unit.scope_ui_bridge.web_rig import Rig, page
here, imencode = [], cv2.imencode
cv2.imencode = lambda *given: here.append(os.sched_getscheduler(0)) or imencode(*given)
refusal = ask_for_real_time(BRIDGE)
async def look(rig):
    async with page(rig, control=False) as viewer:
        await viewer.open_video()
        rig.offer()
        await viewer.frame()
with Rig() as rig:
    asyncio.run(look(rig))
    threads = pathlib.Path(f"/proc/{rig.server.encoder.pid}/task").iterdir()
    beside = [os.sched_getscheduler(int(thread.name)) for thread in threads]
print(json.dumps([refusal or os.sched_getscheduler(0), here, beside]))
"""


@pytest.fixture
def encoder() -> Iterator[JpegEncoder]:
    made = JpegEncoder()
    yield made
    made.close()


def test_pictures_are_not_encoded_before_ordinary_programs_have_their_turn() -> None:
    done = subprocess.run(
        [sys.executable, "-c", IN_REAL_TIME],
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},  # with the tests' own folder
        capture_output=True,
        text=True,
        timeout=3 * WITHIN_S,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    bridge, here, beside = json.loads(done.stdout)
    assert bridge == os.SCHED_RR or "not allowed" in bridge
    assert (here, set(beside)) == ([], {os.SCHED_OTHER})


def test_every_form_is_the_picture_that_was_given(encoder: JpegEncoder) -> None:
    wide = np.random.default_rng(SEED).integers(0, 255, (48, 160, 3), np.uint8)
    for picture, encoding in ((wide[:, ::2], "rgb8"), (wide[:, :, 1], "mono8"), (wide, "bgr8")):
        for form in FORMS:
            jpeg = encoder(picture, encoding, 80, form).result(WITHIN_S)
            assert jpeg == to_jpeg(picture, encoding, 80, form)
    shown = cv2.imdecode(
        np.frombuffer(encoder(wide, "bgr8", 80, FORMS[3]).result(WITHIN_S), np.uint8), cv2.IMREAD_COLOR
    )
    assert shown.shape == (24, 80, 3)


def test_a_picture_nobody_can_look_at_is_named_and_the_next_one_encoded(encoder: JpegEncoder) -> None:
    picture = np.zeros((8, 8), np.uint8)
    with pytest.raises(ValueError, match="encoding 'mono16' is none of"):
        encoder(picture.astype(np.uint16), "mono16", 80).result(WITHIN_S)
    with pytest.raises(ValueError, match="OpenCV"):
        encoder(picture[:0], "mono8", 80).result(WITHIN_S)
    assert encoder(picture, "mono8", 80).result(WITHIN_S) == to_jpeg(picture, "mono8", 80)


def test_pages_see_on_when_the_process_has_died() -> None:
    async def scenario(rig: Rig) -> None:
        async with page(rig, control=False) as client:
            await client.open_video()
            rig.offer()
            await client.frame()
            first = rig.server.encoder.pid
            assert first is not None
            os.kill(first, signal.SIGKILL)
            rig.offer()  # is lost with it
            await until(lambda: rig.server.encoder.pid is None, "the death is noticed")
            stamp = rig.offer()
            assert (await client.frame())[0]["stamp"] == str(stamp)
            assert rig.server.encoder.pid not in (None, first)

    with_rig(scenario)


def test_pages_see_on_when_the_process_hangs(caplog: pytest.LogCaptureFixture) -> None:
    async def scenario(rig: Rig) -> None:
        async with page(rig, control=False) as client:
            await client.open_video()
            rig.offer()
            await client.frame()
            for told in (1, 2):  # each time
                first = rig.server.encoder.pid
                assert first is not None
                os.kill(first, signal.SIGSTOP)
                rig.offer()  # is lost with it
                await until(lambda: rig.server.encoder.pid is None, "the hang is noticed")
                await until(lambda first=first: not works(first), "it is ended")
                stamp = rig.offer()
                assert (await client.frame())[0]["stamp"] == str(stamp)
                assert caplog.text.count("started anew: TimeoutError('it hung for 3 s')") == told

    with_rig(scenario)


def test_closing_it_twice_closes_no_file_of_others(tmp_path: Path) -> None:
    encoder = JpegEncoder()
    encoder.close()
    with (tmp_path / "a").open("w") as other:  # has the number that was given back
        encoder.close()
        other.write("whole")
    assert (tmp_path / "a").read_text() == "whole"


@pytest.mark.parametrize("way", ["closed", "killed"])
def test_it_ends_with_the_bridge(way: str) -> None:
    code = f"""import os, numpy as np
from scope_ui_bridge.adapters.video.jpeg_encoder import JpegEncoder
encoder = JpegEncoder()
encoder(np.zeros((8, 8), np.uint8), "mono8", 80).result({WITHIN_S})
print(encoder.pid, flush=True)
encoder.close() if {way == "closed"} else os.kill(os.getpid(), 9)"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=WITHIN_S, check=False)
    assert (done.stderr, done.returncode) == ("", 0 if way == "closed" else -signal.SIGKILL)
    wait_until(lambda: not works(int(done.stdout)), "it ends with the bridge", WITHIN_S)


def works(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False
