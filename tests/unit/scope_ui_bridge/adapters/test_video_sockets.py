"""Video connections: what is encoded for whom."""

from __future__ import annotations

import json
import time

import aiohttp
import cv2
import numpy as np
import pytest
from unit.scope_ui_bridge.web_rig import WITHIN_S, Rig, page, until, with_rig

from scope_ui_bridge.adapters.video import video_hub
from scope_ui_bridge.core.video import FrameWindow


async def still_there(rig: Rig) -> None:
    async with aiohttp.ClientSession(rig.url) as session, session.get("/session") as answer:
        assert answer.status == 401


def test_nothing_is_encoded_while_nobody_watches_and_once_for_all_who_do() -> None:
    async def scenario(rig: Rig) -> None:
        for _ in range(5):
            rig.offer()
        async with page(rig, control=False) as one, page(rig, control=False) as two, page(rig, control=False) as right:
            assert rig.server.video.encoded == 0
            await one.open_video()
            await one.frame()
            assert rig.server.video.encoded == 1
            await two.open_video()
            await two.frame()
            await right.open_video(camera="right")
            for level in (40, 200):
                begin_s = time.monotonic()
                stamp = rig.offer(level=level)
                for client in (one, two):
                    about, jpeg = await client.frame()
                    now_s = time.monotonic()
                    took_ms = (now_s - begin_s) * 1e3 + 1
                    assert (about["stamp"], about["width"], about["height"]) == (str(stamp), 128, 72)
                    picture = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
                    assert abs(float(picture.mean()) - level) < 2
                    assert -1 < about["age_ms"] < took_ms
                    assert 0 <= now_s * 1e3 - about["sent_ms"] + 0.1 < took_ms
            assert rig.server.video.encoded == 3
            rig.offer("right", level=120)
            await right.frame()
            assert rig.server.video.encoded == 4

    with_rig(scenario)


def test_a_page_that_does_not_draw_gets_two_pictures_and_does_not_slow_another() -> None:
    async def scenario(rig: Rig) -> None:
        async with page(rig, control=False) as stalled, page(rig, control=False) as good:
            await stalled.open_video()
            await good.open_video()
            got = []
            for _ in range(6):
                rig.offer()
                about, _ = await good.frame()
                got.append(about["seq"])
            assert len(set(got)) == 6
            first, _ = await stalled.frame(acknowledge=False)
            second, _ = await stalled.frame(acknowledge=False)
            assert first["seq"] < second["seq"] <= got[-1]
            await stalled.video.send_str(json.dumps({"drawn": second["seq"]}))
            newest, _ = await stalled.frame()
            assert newest["seq"] == got[-1], "what it missed in between is never sent"

    with_rig(scenario)


def test_the_overlay_comes_with_the_first_picture_and_again_when_the_panel_moves() -> None:
    async def scenario(rig: Rig) -> None:
        corners = np.array([[1.04, 2.0], [np.nan, 1.0], [5.0, 6.5]], np.float32)
        edges = np.array([[1, 1, 0], [9, 1, 0], [9, 4, 0], [3, 3, 1], [4, 4, 1], [7, 7, 2]], np.float32)
        async with page(rig, control=False) as client:
            stamp = rig.offer()
            rig.server.mailbox.each(rig.desk.scene.layers.take, "corners", "left", stamp, corners)
            rig.server.mailbox.each(rig.desk.scene.layers.take, "edges", "left", stamp - 10**8, edges)
            await client.open_video(corners=True, edges=True)
            await until(lambda: rig.server.video.wanted == {("corners", "left"), ("edges", "left")}, "the wish")
            about, _ = await client.frame()
            assert [control["name"] for control in about["panel"]["controls"]] == ["RUN_STOP", "CH1_SCALE", "CH1_IN"]
            rig.offer(stamp_ns=stamp + 10**8)  # the encoder may start slower than corners get too old
            about, _ = await client.frame()
            assert "panel" not in about
            assert about["corners"] == [1.0, 2.0, 5.0, 6.5]
            assert about["edges"] == [[1, 1, 9, 1, 9, 4], [3, 3, 4, 4]], "a single point is no line"
            await client.video.send_str('{"camera":"left","corners":true,"edges":false}')
            await until(lambda: rig.server.video.wanted == {("corners", "left")}, "fewer layers")
            rig.offer(stamp_ns=stamp + 2 * 10**9)
            about, _ = await client.frame()
            assert about["corners"] == [] and "edges" not in about, "what is older than the picture is not shown"
            rig.server.mailbox.each(rig.desk.scene.changed)
            rig.offer()
            about, _ = await client.frame()
            assert about["panel"]["version"] == rig.desk.scene.version
        await until(lambda: rig.server.video.wanted == frozenset(), "no page shows a camera any more")

    with_rig(scenario)


def test_bad_video_messages_are_answered() -> None:
    async def scenario(rig: Rig) -> None:
        async with page(rig, control=False) as client:
            await client.open_video()
            for text in (
                "{",
                '{"drawn":"1"}',
                '{"camera":"up","corners":true}',
                '{"camera":"left","edges":1}',
                "y" * 40000,
            ):
                await client.video.send_str(text)
                answer = json.loads((await client.video.receive(timeout=WITHIN_S)).data)
                assert answer["code"] in ("malformed", "oversized")
            rig.offer()
            await client.frame()

    with_rig(scenario)


def test_a_picture_nobody_can_look_at_is_skipped() -> None:
    async def scenario(rig: Rig) -> None:
        async with page(rig, control=False) as client:
            await client.open_video()
            odd = np.zeros((8, 8), np.uint8)
            rig.server.mailbox.newest("left", rig.server.video.offer, "left", 1, "bayer_rggb8", odd)
            await still_there(rig)
            stamp = rig.offer()
            about, _ = await client.frame()
            assert about["stamp"] == str(stamp)

    with_rig(scenario)


def test_a_page_behind_a_slow_link_gets_light_pictures_and_the_others_full_ones(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    clock_s = 0.0

    class Timed(FrameWindow):
        """By the test's clock."""

        def sent(self, seq: int, now_s: float) -> None:
            super().sent(seq, clock_s)

        def acknowledged(self, seq: int, now_s: float) -> None:
            super().acknowledged(seq, clock_s)

    async def under_way(rig: Rig, count: int) -> None:
        windows = [viewer.window for viewer in rig.server.video._viewers]
        await until(lambda: sum(len(window._under_way) for window in windows) == count, "what was drawn is known")

    async def scenario(rig: Rig) -> None:
        nonlocal clock_s
        async with page(rig, control=False) as slow, page(rig, control=False) as good:
            await slow.open_video()
            await good.open_video()
            light = []
            for _ in range(6):
                rig.offer()
                about, jpeg = await slow.frame(acknowledge=False)
                light.append(about["light"])
                full, whole = await good.frame()
                assert not full["light"]
                await under_way(rig, 1)
                clock_s += 0.25
                await slow.video.send_str(json.dumps({"drawn": about["seq"]}))
                await under_way(rig, 0)
            assert light == [False] * 5 + [True]
            assert (about["width"], about["height"]) == (full["width"], full["height"]), "pixels mean the same"
            assert len(jpeg) < len(whole)

    monkeypatch.setattr(video_hub, "FrameWindow", Timed)
    with_rig(scenario)
