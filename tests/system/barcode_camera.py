"""A camera whose pictures carry the moment they were made, as a row of black and white blocks, for measuring delays.

Run as a program: ``barcode_camera.py --rate 30 --picture FILE``. 32 blocks from the upper left corner, 20 px each, the
most significant bit first: 24 bits of milliseconds of the wall clock, then 8 bits that must be their XOR with 0x5A.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, Image

from icu_common.core.geometry.frames import CAMERA_LEFT
from icu_common.nodes import qos
from icu_common.nodes.messages.cameras import image_message
from icu_common.nodes.messages.heads import header
from icu_common.nodes.runtime import run

BLOCK_PX = 20
BITS = 32


def code(milliseconds: int) -> int:
    """Return the 32 bits of a moment."""
    low = milliseconds & 0xFFFFFF
    return low << 8 | ((low >> 16) ^ (low >> 8) ^ low ^ 0x5A) & 0xFF


def draw(picture: np.ndarray, milliseconds: int) -> None:
    bits = (code(milliseconds) >> np.arange(BITS - 1, -1, -1)) & 1
    row = np.repeat(np.where(bits, 235, 20).astype(np.uint8), BLOCK_PX)
    picture[:BLOCK_PX, : len(row)] = row[None, :, None]


class BarcodeCamera(Node):
    def __init__(self, options: argparse.Namespace, **kwargs: Any) -> None:
        super().__init__("barcode_camera", **kwargs)
        if options.picture:
            self.picture = cv2.resize(cv2.imread(str(options.picture)), (1280, 720))
        else:
            self.picture = np.full((720, 1280, 3), 90, np.uint8)
        self.images = self.create_publisher(Image, "left/image_raw", qos.IMAGES)
        self.infos = self.create_publisher(CameraInfo, "left/camera_info", qos.IMAGES)
        self.create_timer(1.0 / options.rate, self.take)

    def take(self) -> None:
        stamp = int(self.get_clock().now().nanoseconds)
        draw(self.picture, stamp // 1_000_000)
        self.images.publish(image_message(self.picture, "bgr8", header(stamp, CAMERA_LEFT)))


READER = f"""() => {{
  // Notes for each new picture on the page its code's age in ms, as soon as the pixels can be read.
  if (window.ages) return; // once is enough: each further one would count every picture again
  const canvas = document.getElementById('picture');
  const context = canvas.getContext('2d');
  window.ages = []; window.drawn = [];
  let last = -1;
  const read = () => {{
    const row = context.getImageData(0, {BLOCK_PX // 2}, {BITS * BLOCK_PX}, 1).data;
    let value = 0;
    for (let i = 0; i < {BITS}; i += 1) value = value * 2 + (row[4 * (i * {BLOCK_PX} + {BLOCK_PX // 2})] > 128 ? 1 : 0);
    const low = Math.floor(value / 256);
    const good = (((low >> 16) ^ (low >> 8) ^ low ^ 0x5A) & 0xFF) === value % 256;
    const now = performance.timeOrigin + performance.now();
    if (good && low !== last) {{
      last = low;
      window.ages.push((Math.floor(now) - low) & 0xFFFFFF);
      window.drawn.push(now);
    }}
  }};
  const draw = context.drawImage.bind(context);
  context.drawImage = (...all) => {{ draw(...all); read(); }};
}}"""


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rate", type=float, default=30.0, help="pictures per second (30)")
    parser.add_argument("--picture", type=Path, help="what the camera looks at (grey)")
    given, rest = parser.parse_known_args()
    raise SystemExit(run(lambda: BarcodeCamera(given), [sys.argv[0], *rest]))
