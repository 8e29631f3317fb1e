"""A page gets the picture that is newest when it can take one, not the one that was newest before."""

from __future__ import annotations

import asyncio
import json
import math
from concurrent.futures import Future
from typing import Any

import numpy as np
from unit.scope_ui_bridge.desk_rig import Rig

from scope_ui_bridge.adapters.video.jpeg_encoder import to_jpeg
from scope_ui_bridge.adapters.video.video_hub import VideoHub, VideoViewer


class ByHand:
    """Encodes on request."""

    def __init__(self) -> None:
        self.jobs: list[tuple[Future[Any], Any]] = []

    def __call__(self, *arguments: Any) -> Future[bytes]:
        self.jobs.append((Future(), lambda: to_jpeg(*arguments)))
        return self.jobs[-1][0]

    async def finish(self) -> None:
        """End the one job there is, and let everything happen that comes of it."""
        await settled()
        ((future, work),) = self.jobs
        self.jobs.clear()
        future.set_result(work())
        await settled()


async def settled() -> None:
    for _ in range(10):
        await asyncio.sleep(0)


class Sent:
    def __init__(self) -> None:
        self.stamps: list[int] = []
        self.ages_ms: list[float] = []

    async def send_bytes(self, data: bytes) -> None:
        about = json.loads(data[4 : 4 + int.from_bytes(data[:4], "big")])
        self.stamps.append(int(about["stamp"]))
        self.ages_ms.append(about["age_ms"])


def test_a_picture_of_the_future_is_no_younger_than_its_time_on_the_page() -> None:
    """With an age below 0 the last image of a camera that has stalled would look live for that long."""

    async def scenario() -> None:
        encoder, socket = ByHand(), Sent()
        hub = VideoHub(Rig().desk, encoder, lambda: 80, lambda: 1_000_000_000)
        viewer = VideoViewer(socket=socket)  # type: ignore[arg-type]
        hub.add(viewer)
        hub.look(viewer, "left", frozenset())
        serving = asyncio.create_task(hub.serve(viewer))
        for seq, stamp in enumerate((3_600_000_000_000, 750_000_000), 1):
            hub.offer("left", stamp, "mono8", np.zeros((72, 128), np.uint8))
            await encoder.finish()
            viewer.window.acknowledged(seq, 0.0)
            hub.kick(viewer)
        serving.cancel()
        assert socket.ages_ms == [0.0, 250.0]

    asyncio.run(scenario())


def test_no_picture_is_encoded_in_advance_and_grows_old_until_there_is_room() -> None:
    async def scenario() -> None:
        encoder, socket = ByHand(), Sent()
        hub = VideoHub(Rig().desk, encoder, lambda: 80, lambda: 0)
        viewer = VideoViewer(socket=socket)  # type: ignore[arg-type]
        hub.add(viewer)
        hub.look(viewer, "left", frozenset())
        viewer.window.level, viewer.window._heavier_at_s = 4, math.inf  # one at a time, whatever the clock says
        serving = asyncio.create_task(hub.serve(viewer))
        offer = lambda stamp: hub.offer("left", stamp, "mono8", np.zeros((72, 128), np.uint8))  # noqa: E731
        seq = 0
        for begin in (0, 10, 20):
            offer(begin + 1)  # while the page has room
            offer(begin + 2)  # while that one is being encoded
            await encoder.finish()
            assert socket.stamps[-1] == begin + 1
            assert encoder.jobs == [], "nothing more until the page has room again"
            offer(begin + 3)
            viewer.window.acknowledged(seq + 1, 0.0)
            hub.kick(viewer)
            await encoder.finish()
            assert socket.stamps[-1] == begin + 3, "the newest at the acknowledgement"
            seq += 3
            viewer.window.acknowledged(seq, 0.0)
            hub.kick(viewer)
        serving.cancel()

    asyncio.run(scenario())


def test_a_camera_that_was_not_listened_to_shows_nothing_from_before() -> None:
    """A user who looks at it again would see an image of minutes ago, and a page in the middle of a motion would stop
    it."""

    async def scenario() -> None:
        encoder, socket = ByHand(), Sent()
        hub = VideoHub(Rig().desk, encoder, lambda: 80, lambda: 0)
        viewer = VideoViewer(socket=socket)  # type: ignore[arg-type]
        hub.add(viewer)
        serving = asyncio.create_task(hub.serve(viewer))
        picture = np.zeros((72, 128), np.uint8)
        hub.look(viewer, "right", frozenset())
        assert hub.cameras == {"right"}
        hub.offer("right", 1, "mono8", picture)
        await encoder.finish()
        hub.offer("right", 2, "mono8", picture)
        hub.look(viewer, "left", frozenset())
        assert hub.cameras == {"left"}
        hub.forget("right")  # while its last one is being encoded
        await encoder.finish()
        hub.look(viewer, "right", frozenset())
        hub.kick(viewer)
        await settled()
        assert (socket.stamps, encoder.jobs, hub.newest("right")) == ([1], [], None)
        hub.offer("right", 3, "mono8", picture)
        await encoder.finish()
        serving.cancel()
        assert socket.stamps == [1, 3]

    asyncio.run(scenario())
