"""A studio with an emulated station for tests of the whole, and what they need."""

from __future__ import annotations

import json
import os
import subprocess
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from takes import MODELS, RecordedTake, record_demo, replayed

from palpate import Control, Palpate, PalpateError
from palpate.documents import LiveDocument

CHECKOUT = Path(__file__).resolve().parents[3]
TRUTH = CHECKOUT / "assets/truth/small.toml"
PATIENCE_S = 60.0
"""Whatever is waited for comes long before this, unless it never does."""


@dataclass
class Studio:
    """A running studio and its data folder, with the session `small`."""

    url: str
    data: Path


def tool(name: str, what: str) -> Path:
    """A file or folder that the environment variable `name` names; a test that needs it fails without it."""
    path = os.environ.get(name)
    if not path or not Path(path).exists():
        pytest.fail(f"{name} must name {what} (it is {path!r}); `cargo xtask test python_client` sets everything up")
    return Path(path)


def until(what: str, wanted: Callable[[], bool]) -> None:
    """Waits until something is so."""
    begun = time.monotonic()
    while not wanted():
        if time.monotonic() - begun > PATIENCE_S:
            pytest.fail(f"never {what}")
        time.sleep(0.05)


def arm_and_move(hand: Control, positions: dict[str, float]) -> LiveDocument:
    """Arms and moves. A machine that is busy with other work may keep heartbeats waiting: then it arms again."""
    begun = time.monotonic()
    while True:
        try:
            if hand.live().phase != "armed":
                hand.arm()
            return hand.move(positions)
        except PalpateError as error:
            if "nothing was heard" not in error.detail or time.monotonic() - begun > PATIENCE_S:
                raise


@pytest.fixture(scope="session")
def binary() -> Path:
    return tool("PALPATE_BIN", "the `palpate` program of this checkout")


@pytest.fixture(scope="session")
def recorded(binary: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A session folder, as a studio keeps them."""
    folder = tmp_path_factory.mktemp("recorded") / "small"
    subprocess.run([binary, "emulate", "--truth", TRUTH, "--out", folder], check=True, stdout=subprocess.DEVNULL)
    return folder


@pytest.fixture(scope="session")
def touch_library() -> Path:
    return tool("PALPATE_TOUCH_LIBRARY", "the library of `palpate.touch`")


@pytest.fixture(scope="session")
def demo_replays(binary: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[RecordedTake]]:
    """What `palpate replay` makes of each take of the demonstration, by model."""
    folder = tmp_path_factory.mktemp("demo")
    takes = record_demo(binary, folder / "session")
    return {
        name: [replayed(binary, take, model, folder / f"{name}-{take.name}") for take in takes]
        for name, model in MODELS.items()
    }


@pytest.fixture(scope="session")
def studio(binary: Path, recorded: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Studio]:
    data = tmp_path_factory.mktemp("data")
    log = (data / "studio.log").open("w")
    command: list[str | Path] = [binary, "serve", "--listen", "127.0.0.1:0", "--json", "--data", data]
    command += ["--emulate", TRUTH]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=log, text=True)
    assert process.stdout is not None
    try:
        url = json.loads(process.stdout.readline())["url"]
        with Palpate(url) as p:
            p.upload(recorded)
        yield Studio(url, data)
    finally:
        process.terminate()
        process.wait(timeout=30)
        log.close()


@pytest.fixture
def p(studio: Studio) -> Iterator[Palpate]:
    with Palpate(studio.url) as client:
        yield client
