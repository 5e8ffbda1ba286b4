"""The station as a robot of LeRobot, without lerobot."""

from __future__ import annotations

import math

import pytest
from conftest import Studio, until

from palpate import Palpate, PalpateError
from palpate.lerobot import PalpateRobot, PalpateRobotConfig

JOINT = "index_mcp_forward"


def test_a_policy_sees_the_station_and_moves_it_within_its_limits(p: Palpate, studio: Studio) -> None:
    station = p.station()
    robot = PalpateRobot(studio.url, name="policy")
    assert list(robot.action_features) == [f"{joint}.pos" for joint in station.joints]
    with pytest.raises(PalpateError, match="connect"):
        robot.get_observation()
    until("ready", lambda: all(device.link == "ready" for device in p.live().devices))
    robot.connect()
    try:
        assert robot.is_connected
        until("seen to have control", lambda: p.live().holder == "policy")
        seen = robot.get_observation()
        assert list(seen) == list(robot.observation_features)
        assert len(seen) == len(station.joints) + 2 * len(station.channels)
        goal = seen[f"{JOINT}.pos"] + 0.3

        def arrives() -> bool:
            try:
                assert robot.send_action({f"{JOINT}.pos": goal}) == {f"{JOINT}.pos": goal}
            except PalpateError:
                # A machine that is busy with other work may keep heartbeats waiting: then the station disarms.
                if p.live().phase != "disarmed":
                    raise
                robot.disconnect()
                robot.connect()
            return abs(robot.get_observation()[f"{JOINT}.pos"] - goal) <= 0.05

        until("where it was sent", arrives)
        for action, words in [
            ({"nose.pos": 0.0}, "nose"),
            ({JOINT: 0.0}, "actions are named"),
            ({f"{JOINT}.pos": math.nan}, "finite"),
            ({f"{JOINT}.pos": 99.0}, "above its limit"),
        ]:
            with pytest.raises(PalpateError, match=words):
                robot.send_action(action)
        with pytest.raises(PalpateError, match="disconnect first"):
            robot.connect()
    finally:
        robot.disconnect()
    assert not robot.is_connected
    until("seen to have given it back", lambda: p.live().holder == "")
    robot.disconnect()


def test_touch_can_be_left_out(studio: Studio) -> None:
    robot = PalpateRobot(PalpateRobotConfig(url=studio.url, touch=False, id="left"))
    assert list(robot.observation_features) == list(robot.action_features)
    assert str(robot) == "left PalpateRobot"
    with pytest.raises(PalpateError, match="touch"):
        PalpateRobot(PalpateRobotConfig(), touch=True)
