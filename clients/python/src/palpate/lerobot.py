"""The live station as a robot of LeRobot: its policies drive it through lease and safety layer.

from palpate.lerobot import PalpateRobot

with PalpateRobot("http://127.0.0.1:8080", name="my policy") as robot:
    while True:
        robot.send_action(policy(robot.get_observation()))

`PalpateRobot` has the interface of `lerobot.robots.Robot` and needs no lerobot.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from dataclasses import dataclass
from types import TracebackType
from typing import TYPE_CHECKING, Any

from palpate.client import Palpate
from palpate.errors import PalpateError
from palpate.traces import NewestFrame, frame_of

if TYPE_CHECKING:
    from palpate.control import Control
    from palpate.station import Station

POSITION = ".pos"
"""What LeRobot writes behind the name of a joint."""
RAW = ".raw"
ACTIVE = ".active"


@dataclass
class PalpateRobotConfig:
    """Where the station is, and what is seen of it."""

    url: str | None = None
    """Address of the studio; without, `PALPATE_URL`, else http://127.0.0.1:8080."""
    token: str | None = None
    """API token; without, `PALPATE_TOKEN`."""
    name: str = "lerobot"
    """Who has control, for others and for the audit log."""
    take_over: bool = False
    """Take control from whoever has it."""
    touch: bool = True
    """Readings and activations are part of the observation."""
    id: str | None = None
    """LeRobot's name for this robot."""


class PalpateRobot:
    """A station of a studio with LeRobot's robot interface.

    Observations are numbers by name: `<joint>.pos` (rad or m), `<channel>.raw` (less its reference) and
    `<channel>.active`. Actions are `<joint>.pos`. Every command passes the station's safety layer, which limits speed,
    acceleration and range.
    """

    name = "palpate"

    def __init__(self, config: PalpateRobotConfig | str | None = None, **settings: Any) -> None:  # noqa: ANN401
        """`config`, or the address of the studio and other settings of the configuration by name."""
        if not isinstance(config, PalpateRobotConfig):
            config = PalpateRobotConfig(url=config, **settings)
        elif settings:
            raise PalpateError("Bad arguments", f"{sorted(settings)} belong into the configuration that was given")
        self.config = config
        self.id = config.id
        self._stack = contextlib.ExitStack()
        self._hand: Control | None = None
        self._frames: NewestFrame | None = None
        self._known: Station | None = None

    # What LeRobot asks before it begins

    @property
    def observation_features(self) -> dict[str, type]:
        """Names of an observation's numbers, in the order of the station."""
        station = self._station()
        features: dict[str, type] = {f"{joint}{POSITION}": float for joint in station.joints}
        if self.config.touch:
            features |= {f"{channel}{RAW}": float for channel in station.channels}
            features |= {f"{channel}{ACTIVE}": float for channel in station.channels}
        return features

    @property
    def action_features(self) -> dict[str, type]:
        """Names of an action's numbers, in the order of the station."""
        return {f"{joint}{POSITION}": float for joint in self._station().joints}

    @property
    def is_connected(self) -> bool:
        """Whether it has control."""
        return self._hand is not None

    @property
    def is_calibrated(self) -> bool:
        """Always: what a joint's zero is stands in the station file."""
        return True

    def calibrate(self) -> None:
        """Nothing: joints need no calibration by LeRobot."""

    def configure(self) -> None:
        """Nothing: limits are those of the station."""

    # While it runs

    def connect(self, calibrate: bool = True) -> None:
        """Takes control and arms: torque comes up where the joints are."""
        if self._hand is not None:
            raise PalpateError("Connected already", "disconnect first")
        with contextlib.ExitStack() as stack:
            palpate = stack.enter_context(Palpate(self.config.url, self.config.token))
            self._known = palpate.station()
            socket = stack.enter_context(palpate.connection.socket("GET", "/stream", max_queue=16))
            hand = stack.enter_context(palpate.control(self.config.name, take_over=self.config.take_over))
            hand.arm()
            # What came in while it armed is old.
            self._frames, self._hand = NewestFrame(socket), hand
            self._stack = stack.pop_all()

    def get_observation(self) -> dict[str, float]:
        """The newest state of the station; waits for one that was not given yet."""
        frames, station = self._open()[0], self._station()
        newest = frames.wait()
        if newest is None:
            raise PalpateError("Stream ended", "the studio has ended the stream of live frames")
        frame = frame_of(newest[0], station, newest[1])
        values = list(frame.joint_positions)
        if self.config.touch:
            values += [*frame.raw, *frame.active]
        return {name: float(value) for name, value in zip(self.observation_features, values, strict=True)}

    def send_action(self, action: Mapping[str, Any]) -> dict[str, float]:
        """Says where joints shall go; gives what was said. A target beyond a joint's limits is refused, all of them."""
        hand = self._open()[1]
        wrong = [name for name in action if not name.endswith(POSITION)]
        if wrong:
            raise PalpateError("No such joint", f"{wrong}; actions are named {list(self.action_features)}")
        targets = {name.removesuffix(POSITION): float(value) for name, value in action.items()}
        hand.targets(targets)
        return {f"{joint}{POSITION}": value for joint, value in targets.items()}

    def disconnect(self) -> None:
        """Disarms and gives control back; does nothing where there is none."""
        self._frames = self._hand = None
        self._stack.close()

    def __enter__(self) -> PalpateRobot:
        self.connect()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.disconnect()

    def __str__(self) -> str:
        return f"{self.id or ''} {type(self).__name__}".strip()

    def _open(self) -> tuple[NewestFrame, Control]:
        if self._frames is None or self._hand is None:
            raise PalpateError("Not connected", "connect() first")
        return self._frames, self._hand

    def _station(self) -> Station:
        """The station, which LeRobot asks about before it connects."""
        if self._known is None:
            with Palpate(self.config.url, self.config.token) as palpate:
                self._known = palpate.station()
        return self._known
