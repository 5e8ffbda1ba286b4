"""The demonstration's session, and what `palpate replay` makes of it."""

from __future__ import annotations

import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from numpy.typing import NDArray

CHECKOUT = Path(__file__).resolve().parents[3]
STATION = CHECKOUT / "assets/stations/xarm6_leap.toml"
MODELS = {
    "nominal": CHECKOUT / "assets/models/nominal.toml",
    "diagnosed": CHECKOUT / "assets/models/demo_diagnosed.toml",
}
STREAMS = ("twintac", "fsr")
"""In the order of the channels."""


@dataclass(frozen=True)
class RecordedTake:
    """A take with the readings of a model, as `palpate replay` wrote it."""

    object: str
    pose: NDArray[np.float64]
    times_s: NDArray[np.float64]
    positions: NDArray[np.float64]
    raw: NDArray[np.float32]
    active: NDArray[np.bool_]


def record_demo(binary: Path, folder: Path) -> list[Path]:
    """Records the session and gives the files of its takes."""
    command: list[str | Path] = [binary, "emulate", "--truth", CHECKOUT / "assets/truth/demo.toml", "--out", folder]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return sorted(folder.glob("take-*.mcap"))


def replayed(binary: Path, take: Path, model: Path, out: Path) -> RecordedTake:
    """What `palpate replay` makes of `take` with `model`."""
    command: list[str | Path] = [binary, "replay", "--take", take, "--model", model, "--out", out]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return read_take(out)


def read_take(path: Path) -> RecordedTake:
    """A take whose every message is of a joint frame."""
    positions: list[list[float]] = []
    log_times_ns: list[int] = []
    raw: dict[str, list[list[float]]] = {stream: [] for stream in STREAMS}
    active: dict[str, list[list[bool]]] = {stream: [] for stream in STREAMS}
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        about = {record.name: record.metadata for record in reader.iter_metadata()}["palpate.take"]
        for _, channel, message, decoded in reader.iter_decoded_messages():
            if channel.topic == "/joint_states":
                log_times_ns.append(message.log_time)
                positions.append([joint.position for joint in decoded.joints])
            elif channel.topic.startswith("/tactile/"):
                stream = channel.topic.removeprefix("/tactile/")
                raw[stream].append(list(decoded.raw))
                active[stream].append(list(decoded.active))
    start_ns = int(about["start_unix_ns"])
    pose = [float(number) for key in ("position_m", "quaternion_wxyz") for number in about[f"object_{key}"].split()]
    return RecordedTake(
        about["object"],
        np.array(pose),
        np.array([(time_ns - start_ns) / 1e9 for time_ns in log_times_ns]),
        np.array(positions),
        np.concatenate([np.array(raw[stream], dtype=np.float32) for stream in STREAMS], axis=1),
        np.concatenate([np.array(active[stream], dtype=np.bool_) for stream in STREAMS], axis=1),
    )
