"""Reads a LeRobotDataset v3.0 by the calls that LeRobot itself makes; with --class by its own class.

python lerobot_check.py DATA_SET [--class]
"""

import json
import os
import sys
import tempfile
from pathlib import Path

# `datasets` keeps a copy of what it reads below HF_HOME.
CACHE = tempfile.TemporaryDirectory()
os.environ.update(HF_HUB_OFFLINE="1", HF_HOME=CACHE.name, HF_DATASETS_DISABLE_PROGRESS_BARS="1")


def by_class(root: Path) -> None:
    import torch
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    data = LeRobotDataset("palpate/check", root=root)
    info = json.loads((root / "meta/info.json").read_text())
    assert len(data) == info["total_frames"] and data.num_episodes == info["total_episodes"]
    item = data[len(data) // 2]
    assert isinstance(item["task"], str), item["task"]
    assert item["observation.state"].shape == (info["features"]["observation.state"]["shape"][0],)
    fps = data.fps
    windows = {"observation.state": [-1 / fps, 0.0], "observation.tactile.raw": [-1 / fps, 0.0]}
    last = LeRobotDataset("palpate/check", root=root, episodes=[data.num_episodes - 1], delta_timestamps=windows)
    batch = next(iter(torch.utils.data.DataLoader(last, batch_size=8, shuffle=True)))
    print("class: ok", {key: tuple(value.shape) for key, value in batch.items() if hasattr(value, "shape")})


def by_parts(root: Path) -> None:
    import datasets
    import numpy as np
    import pandas as pd

    info = json.loads((root / "meta/info.json").read_text())
    assert info["codebase_version"] == "v3.0" and info["fps"] > 0

    def feature(about: dict) -> object:
        value = datasets.Value(about["dtype"])
        return value if about["shape"] == [1] else datasets.Sequence(length=about["shape"][0], feature=value)

    def table(folder: str, features: datasets.Features | None = None) -> datasets.Dataset:
        files = [str(path) for path in sorted((root / folder).glob("*/*.parquet"))]
        return datasets.Dataset.from_parquet(files, features=features, cache_dir=CACHE.name)

    features = {name: feature(about) for name, about in info["features"].items()}
    frames = table("data", datasets.Features(features))
    episodes = table("meta/episodes")
    tasks = pd.read_parquet(root / "meta/tasks.parquet")
    assert isinstance(tasks.iloc[0].name, str), "the index of pandas is not the task"
    assert len(frames) == info["total_frames"]
    assert len(episodes) == info["total_episodes"]
    assert len(tasks) == info["total_tasks"]
    columns = {name: np.asarray(frames[name][:], dtype=np.float64) for name in features}
    assert (columns["index"] == np.arange(len(frames))).all()
    at = 0
    for episode in episodes:
        span = slice(at, at + episode["length"])
        assert (episode["dataset_from_index"], episode["dataset_to_index"]) == (span.start, span.stop)
        assert (columns["episode_index"][span] == episode["episode_index"]).all()
        expected = np.arange(episode["length"]) / info["fps"]
        assert np.abs(columns["timestamp"][span] - expected).max() < 1e-4, "LeRobot's tolerance"
        task = tasks[tasks.task_index == columns["task_index"][at]].iloc[0].name
        assert episode["tasks"] == [task]
        at = span.stop
    stats = json.loads((root / "meta/stats.json").read_text())
    assert stats.keys() == features.keys()
    for name, values in columns.items():
        values = values.reshape(len(frames), -1)
        quantiles = {f"q{share:02}": np.quantile(values, share / 100, axis=0) for share in (1, 10, 50, 90, 99)}
        moments = {"min": values.min(0), "max": values.max(0), "mean": values.mean(0), "std": values.std(0)}
        assert stats[name]["count"] == [len(frames)]
        for key, expected in (moments | quantiles).items():
            assert np.allclose(stats[name][key], expected, rtol=1e-9, atol=1e-9), f"{name}: {key}"
    shapes = {name: values.shape[1:] for name, values in columns.items()}
    print("parts: ok", len(frames), "frames,", len(episodes), "episodes", shapes)


if __name__ == "__main__":
    arguments = sys.argv[1:]
    if not arguments:
        sys.exit(__doc__)
    (by_class if "--class" in arguments[1:] else by_parts)(Path(arguments[0]))
