"""A small LeRobot dataset, in the layout of either version."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import polars

NAMES = ["shoulder_pan.pos", "gripper.pos"]


def frames(episodes: int = 4, steps: int = 10, fps: float = 20.0) -> polars.DataFrame:
    """Frames of which the state is its frame and its episode."""
    index = np.arange(episodes * steps)
    frame, episode = index % steps, index // steps
    return polars.DataFrame(
        {
            "observation.state": np.stack([frame, episode], axis=1).astype(np.float32),
            "action": np.stack([frame / 2, -frame], axis=1).astype(np.float32),
            "next.done": frame == steps - 1,
            "timestamp": (frame / fps).astype(np.float32),
            "frame_index": frame,
            "episode_index": episode,
            "index": index,
            "task_index": index % 3,
        }
    )


def info(version: str = "v3.0", **changes: Any) -> dict[str, Any]:
    """What `meta/info.json` holds."""
    vector = {"dtype": "float32", "shape": [2], "names": NAMES}
    scalar = {"dtype": "int64", "shape": [1], "names": None}
    return {
        "codebase_version": version,
        "fps": 20,
        "features": {
            "observation.state": vector,
            "action": vector | {"names": {"motors": NAMES}},
            "observation.images.top": {"dtype": "video", "shape": [4, 4, 3], "names": ["height", "width", "channels"]},
            "timestamp": scalar | {"dtype": "float32"},
            "frame_index": scalar,
            "episode_index": scalar,
        },
        **changes,
    }


def write_v3(folder: Path, table: polars.DataFrame, *cuts: int, **changes: Any) -> None:
    """Write a dataset of version 3, with a new file at each row of `cuts`."""
    _write_info(folder, info(**changes))
    (folder / "data" / "chunk-000").mkdir(parents=True, exist_ok=True)
    for number, (start, end) in enumerate(zip([0, *cuts], [*cuts, len(table)], strict=True)):
        table[start:end].write_parquet(folder / "data" / "chunk-000" / f"file-{number:03d}.parquet")
    listed = folder / "meta" / "episodes" / "chunk-000"
    listed.mkdir(parents=True, exist_ok=True)
    _lengths(table).write_parquet(listed / "file-000.parquet")


def write_v2(folder: Path, table: polars.DataFrame, **changes: Any) -> None:
    """Write a dataset of version 2, with a file for each episode and two episodes a chunk."""
    _write_info(folder, info("v2.1", **changes))
    for (episode,), part in table.group_by("episode_index", maintain_order=True):
        chunk = folder / "data" / f"chunk-{int(str(episode)) // 2:03d}"
        chunk.mkdir(parents=True, exist_ok=True)
        part.write_parquet(chunk / f"episode_{int(str(episode)):06d}.parquet")
    lines = [json.dumps({**entry, "tasks": ["push"]}) for entry in _lengths(table).to_dicts()]
    (folder / "meta" / "episodes.jsonl").write_text("\n".join(lines) + "\n")


def _lengths(table: polars.DataFrame) -> polars.DataFrame:
    return table.group_by("episode_index", maintain_order=True).agg(polars.len().cast(polars.Int64).alias("length"))


def _write_info(folder: Path, content: dict[str, Any]) -> None:
    (folder / "meta").mkdir(parents=True, exist_ok=True)
    (folder / "meta" / "info.json").write_text(json.dumps(content))
