"""LeRobot's dataset form, version 3.0 (huggingface/lerobot, ``lerobot.datasets``): an episode for each answered goal.

Images are inside the parquet files, which LeRobot's loader reads without a video decoder; JPEG and PNG of the bag stay
unchanged. Moments without a new image repeat the last one at no cost: equal values are stored once.
"""

from __future__ import annotations

import json
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from icu_bringup.adapters.bag.bag_reader import BagReader
from icu_bringup.adapters.bag.bags import BagError
from icu_bringup.export.adapters.pictures import as_file, pixels
from icu_bringup.export.adapters.reading import kinds_of
from icu_bringup.export.core.frames import Episode, episodes, held, picture_statistics, statistics
from icu_bringup.export.core.session import RecordedSession

VERSION, PER_CHUNK = "v3.0", 1000
DATA = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
EPISODES = "meta/episodes/chunk-000/file-000.parquet"
IMAGES, STATE, ACTION = "observation.images.", "observation.state", "action"
DONE, SUCCESS = "next.done", "next.success"
COUNTERS = {"frame_index": "int64", "episode_index": "int64", "index": "int64", "task_index": "int64"}
STATISTICS_FRAMES = 100


class Dataset:
    """Writes one dataset.

    Parameters
    ----------
    folder
        Folder of the dataset; it must not exist.
    session, fps
        Goals and joint positions, and moments per second.
    cameras
        Name of the camera of each topic with images.

    Raises
    ------
    BagError
        If the bag lacks data that every dataset needs, or the images of a camera differ in size.
    """

    def __init__(self, folder: Path, session: RecordedSession, fps: int, cameras: dict[str, str]) -> None:
        self._folder, self._session, self._fps, self._cameras = folder, session, fps, cameras
        self._shapes: dict[str, tuple[int, int, int]] = {}
        self._samples: dict[str, list[np.ndarray]] = {name: [] for name in cameras.values()}
        self._vectors: dict[str, list[np.ndarray]] = {STATE: [], ACTION: []}
        self._rows: list[dict[str, Any]] = []
        self.tasks: list[str] = []
        self.frames = 0
        self.problems: dict[str, list[str]] = {}
        if not cameras:
            raise BagError("a LeRobot dataset needs images; the bag has none in a topic image_raw")
        self._wanted = episodes(session, fps)
        if not self._wanted:
            raise BagError(
                "a LeRobot dataset needs a goal that was accepted and answered on /gantry/result; the bag has none"
            )

    @property
    def count(self) -> int:
        """Number of episodes written."""
        return len(self._rows)

    def write(self, bag: BagReader) -> None:
        """Read the images, and write data and metadata."""
        kinds = kinds_of(bag)
        numbers = [(time, number) for number, e in enumerate(self._wanted) for time in e.times_ns]
        numbers.sort()
        moments = held([time for time, _ in numbers], bag.messages(set(self._cameras)), self._cameras)
        kind_of_camera = {name: kinds[topic] for topic, name in self._cameras.items()}
        for number, group in groupby(zip(numbers, moments), key=lambda pair: pair[0][1]):
            rows = []
            for _, (time_ns, newest) in group:
                state = self._session.state_at(time_ns)
                if state is not None and len(newest) == len(self._samples):
                    pictures = {n: self._picture(bag, n, kind_of_camera[n], data) for n, data in newest.items()}
                    rows.append((state, self._session.target_at(time_ns), pictures))
            if rows:
                self._write_episode(self._wanted[number], rows)
            else:
                reason = "no image of each camera and no joint positions before its end"
                self.problems.setdefault(self._wanted[number].goal.task, []).append(reason)
        if not self._rows:
            raise BagError(
                "a LeRobot dataset needs images and joint positions before the end of a goal; the bag has none"
            )
        self._write_metadata()

    def _picture(self, bag: BagReader, camera: str, kind: str, data: bytes) -> dict[str, Any]:
        message = bag.decode(data, kind)
        try:
            packed = as_file(message)[1]
            if camera not in self._shapes or len(self._samples[camera]) < STATISTICS_FRAMES:
                picture = pixels(message)
                shape = (*picture.shape[:2], picture.shape[2] if picture.ndim == 3 else 1)
                if picture.dtype != np.uint8 or self._shapes.setdefault(camera, shape) != shape:
                    raise BagError(f"camera {camera}; expected 8-bit images of one size, found {shape}")
                self._samples[camera].append(picture[::4, ::4, ::-1] if shape[2] == 3 else picture[::4, ::4])
        except ValueError as error:
            raise BagError(f"camera {camera}: {error}") from error
        return {"bytes": packed, "path": None}

    def _write_episode(self, episode: Episode, rows: list[tuple[Any, Any, dict[str, Any]]]) -> None:
        import pyarrow as pa
        import pyarrow.parquet as pq

        number, count, task = len(self._rows), len(rows), episode.goal.task
        if task not in self.tasks:
            self.tasks.append(task)
        joints = len(self._session.joint_names)
        vectors = {
            STATE: np.array([state for state, _, _ in rows], np.float32),
            ACTION: np.array([target for _, target, _ in rows], np.float32),
        }
        columns: dict[str, Any] = {}
        for name in self._samples:
            kind = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
            columns[IMAGES + name] = pa.array([pictures[name] for _, _, pictures in rows], kind)
        for key, values in vectors.items():
            self._vectors[key].append(values)
            columns[key] = pa.FixedSizeListArray.from_arrays(pa.array(values.ravel(), pa.float32()), joints)
        last = [i == count - 1 for i in range(count)]
        columns |= {DONE: pa.array(last), SUCCESS: pa.array([end and episode.success for end in last])}
        index = list(range(self.frames, self.frames + count))
        frame = np.arange(count)
        columns |= {
            "timestamp": pa.array((frame / self._fps).astype(np.float32)),
            "frame_index": pa.array(frame),
            "episode_index": pa.array([number] * count, pa.int64()),
            "index": pa.array(index, pa.int64()),
            "task_index": pa.array([self.tasks.index(task)] * count, pa.int64()),
        }
        chunk, file = divmod(number, PER_CHUNK)
        path = self._folder / DATA.format(chunk_index=chunk, file_index=file)
        path.parent.mkdir(parents=True, exist_ok=True)
        pq.write_table(pa.table(columns), path, dictionary_pagesize_limit=1 << 30)
        self._rows.append(
            {
                "episode_index": number,
                "tasks": [task],
                "length": count,
                "dataset_from_index": self.frames,
                "dataset_to_index": self.frames + count,
                "data/chunk_index": chunk,
                "data/file_index": file,
                "meta/episodes/chunk_index": 0,
                "meta/episodes/file_index": 0,
                "success": episode.success,
                "goal_id": episode.goal.goal_id,
                "outcome": episode.goal.outcome,
            }
        )
        self.frames += count

    def _write_metadata(self) -> None:
        import pyarrow as pa
        import pyarrow.parquet as pq

        (self._folder / EPISODES).parent.mkdir(parents=True)
        pq.write_table(pa.Table.from_pylist(self._rows), self._folder / EPISODES)
        # The loader reads tasks with pandas, where the text is the index.
        index = [
            {"name": n, "field_name": n, "pandas_type": p, "numpy_type": k, "metadata": None}
            for n, p, k in (("task_index", "int64", "int64"), ("task", "unicode", "object"))
        ]
        described = {"index_columns": ["task"], "column_indexes": [], "columns": index, "pandas_version": "2.0.0"}
        tasks = pa.table({"task_index": list(range(len(self.tasks))), "task": self.tasks})
        tasks = tasks.replace_schema_metadata({"pandas": json.dumps(described)})
        pq.write_table(tasks, self._folder / "meta/tasks.parquet")
        names = list(self._session.joint_names)
        vector = {"dtype": "float32", "shape": [len(names)], "names": names, "info": {"unit": "m"}}
        scalars = {DONE: "bool", SUCCESS: "bool", "timestamp": "float32", **COUNTERS}
        images = {
            IMAGES + camera: {"dtype": "image", "shape": list(shape), "names": ["height", "width", "channels"]}
            for camera, shape in self._shapes.items()
        }
        info = {
            "codebase_version": VERSION,
            "robot_type": "icu_gantry",
            "total_episodes": len(self._rows),
            "total_frames": self.frames,
            "total_tasks": len(self.tasks),
            "chunks_size": PER_CHUNK,
            "data_files_size_in_mb": 100,
            "video_files_size_in_mb": 200,
            "fps": self._fps,
            "splits": {"train": f"0:{len(self._rows)}"},
            "data_path": DATA,
            "video_path": None,
            "features": {
                **images,
                STATE: vector,
                ACTION: vector,
                **{key: {"dtype": kind, "shape": [1], "names": None} for key, kind in scalars.items()},
            },
        }
        stats = {key: statistics(np.concatenate(values).astype(np.float64)) for key, values in self._vectors.items()}
        stats |= {IMAGES + camera: picture_statistics(samples) for camera, samples in self._samples.items()}
        for name, value in (("info", info), ("stats", stats)):
            (self._folder / f"meta/{name}.json").write_text(json.dumps(value, indent=4), encoding="utf-8")
