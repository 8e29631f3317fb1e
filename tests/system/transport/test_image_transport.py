"""Uncompressed 1280x720 pictures at 30 Hz from the camera to two other processes on two cores, none lost."""

from __future__ import annotations

import itertools
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from support.ros_rig import domain_of_worker

ROOT = Path(__file__).resolve().parents[3]
COUNT = 300
NUMBERS = 40
WITHIN_S = 60.0


@pytest.fixture
def two_cores() -> Iterator[None]:
    """Let this process and what it starts run on two cores only."""
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, set(sorted(before)[:2]))
    yield
    os.sched_setaffinity(0, before)


def write_pictures(folder: Path) -> None:
    """Write pictures that carry their number at both ends and in the middle, so that a part cannot pass for all."""
    noise = np.random.default_rng(1).integers(0, 256, (720, 1280, 3), np.uint8)
    for number in range(NUMBERS):
        noise[0, 0, 0] = noise[360, 640, 1] = noise[-1, -1, 2] = number
        assert cv2.imwrite(str(folder / f"{number}.bmp"), noise)


def lost(rows: list[dict[str, Any]]) -> int:
    """Count the pictures missing between the first and the last: the numbers rise by one, modulo NUMBERS."""
    steps = [(b["marks"][0] - a["marks"][0]) % NUMBERS for a, b in itertools.pairwise(rows)]
    return sum((step - 1) % NUMBERS for step in steps)


@pytest.mark.system
@pytest.mark.alone
def test_none_of_300_pictures_is_lost(tmp_path: Path, two_cores: None) -> None:
    write_pictures(tmp_path)
    environment = dict(os.environ, ROS_DOMAIN_ID=str(domain_of_worker(101, 100)), ROS_LOG_DIR=str(tmp_path / "log"))
    reader = str(Path(__file__).with_name("picture_reader.py"))
    readers = [
        subprocess.Popen(
            [sys.executable, reader, "left/image_raw", str(COUNT), str(WITHIN_S), "30", str(i)],
            env=environment,
            stdout=subprocess.PIPE,
            text=True,
        )
        for i in range(2)
    ]
    settings = {"source": "images", "left_path": str(tmp_path), "rate_hz": "30.0"}
    options = [part for name, value in settings.items() for part in ("-p", f"{name}:={value}")]
    camera = subprocess.Popen(
        [sys.executable, "-m", "harris_perception.nodes.camera_node", "--ros-args", *options], env=environment
    )
    try:
        received = [json.loads(process.communicate(timeout=WITHIN_S + 30)[0]) for process in readers]
    finally:
        camera.send_signal(signal.SIGINT)
        for process in readers:
            process.kill()
            process.wait()
        assert camera.wait(timeout=20) == 0
    for rows in received:
        ages = np.array([row["age_ms"] for row in rows])
        seconds = (rows[-1]["stamp_ns"] - rows[0]["stamp_ns"]) / 1e9
        print(
            f"{len(rows)} pictures in {seconds:.1f} s, lost {lost(rows)}, age p50 {np.median(ages):.1f} ms, "
            f"p99 {np.percentile(ages, 99):.1f} ms"
        )
    for rows in received:
        assert len(rows) == COUNT and lost(rows) == 0
        assert all(len(row["marks"]) == 1 and row["is"] == ["bgr8", 720, 1280, 3] for row in rows)
        stamps = np.array([row["stamp_ns"] for row in rows])
        assert (np.diff(stamps) > 0).all()
        # Slower than asked would be no proof; a loaded machine may be a little late.
        assert (stamps[-1] - stamps[0]) / 1e9 < 1.2 * COUNT / 30
