"""Record one press on the operator page as a moving picture, from a running demo; ``make animation`` starts this.

    PYTHONPATH=tests python -m system.page.press_picture 'http://127.0.0.1:8080/?token=...' -o docs/press.webp

The browser selects RUN_STOP, confirms, and waits for the answer and the seen effect. Each image of the page is shown
for at most MAX_SHOWN_MS, because a busy computer makes the simulation slow. For a long path, move the stylus to the
other side before: gantry_goal 0.320 0.030.
"""

from __future__ import annotations

import argparse
import base64
import itertools
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from system.operator_browser import OPTIONS, Operator, browser_program

WIDTH_PX, QUALITY = 880, 55
EVERY, BEFORE_MS = 4, 700
MIN_SHOWN_MS, MAX_SHOWN_MS, REST_MS = 60, 200, 2500
MAX_BYTES = 3_000_000


def record(address: str) -> list[tuple[np.ndarray, int]]:
    """Return the images of the page (BGR) and how long each is shown, in ms."""
    from playwright.sync_api import sync_playwright

    images: list[tuple[bytes, float]] = []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=browser_program(), args=OPTIONS)
        person = Operator(browser, address)
        person.takes_control()
        person.sees("#chip-controller", "Ready", within_s=60.0)
        # Screenshots would hold the page up until it misses a keep-alive, and the bridge would stop the machine.
        cast = person.context.new_cdp_session(person.page)

        def keep(frame: dict[str, Any]) -> None:
            images.append((base64.b64decode(frame["data"]), time.monotonic()))
            cast.send("Page.screencastFrameAck", {"sessionId": frame["sessionId"]})

        cast.on("Page.screencastFrame", keep)
        cast.send("Page.startScreencast", {"format": "jpeg", "quality": 92, "everyNthFrame": EVERY})
        person.page.wait_for_timeout(BEFORE_MS)
        person.selects("RUN_STOP", "Run")
        person.page.wait_for_timeout(BEFORE_MS)
        person.confirms()
        print(person.logs("Press Run.*(done|aborted|refused|no answer)", 120.0).replace("\n", " "))
        person.page.wait_for_timeout(BEFORE_MS)
        cast.send("Page.stopScreencast")
        person.leaves()
        browser.close()
    times = [taken for _, taken in images]
    shown = [1000 * (later - taken) for taken, later in itertools.pairwise(times)]
    durations = [int(np.clip(ms, MIN_SHOWN_MS, MAX_SHOWN_MS)) for ms in shown] + [REST_MS]
    decoded = [cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR) for jpeg, _ in images]
    return list(zip(decoded, durations, strict=True))


def write(shown: Sequence[tuple[np.ndarray, int]], path: Path) -> None:
    """Write an animated WebP, scaled to WIDTH_PX."""
    animation = cv2.Animation()
    height = round(shown[0][0].shape[0] * WIDTH_PX / shown[0][0].shape[1])
    animation.frames = [cv2.resize(image, (WIDTH_PX, height), interpolation=cv2.INTER_AREA) for image, _ in shown]
    animation.durations = [ms for _, ms in shown]
    if not cv2.imwriteanimation(str(path), animation, [cv2.IMWRITE_WEBP_QUALITY, QUALITY]):
        raise OSError(f"{path} cannot be written")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("address", help="the page's address, with its token, as the demo prints it")
    parser.add_argument("-o", "--output", type=Path, default=Path("docs/press.webp"))
    given = parser.parse_args()
    shown = record(given.address)
    write(shown, given.output)
    size = given.output.stat().st_size
    seconds = sum(ms for _, ms in shown) / 1000
    print(f"{given.output}: {len(shown)} images, {seconds:.1f} s, {size / 1e6:.2f} MB")
    if size > MAX_BYTES:
        print(f"error: {given.output} is larger than {MAX_BYTES / 1e6:g} MB", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
