"""Uses the arm with the vendor's own SDK, unchanged.

    pip install xarm-python-sdk
    python use_arm.py IP

Connects, reads, enables, moves, stops and recovers, and prints one JSON document of what the SDK gave: mostly
`[code, value]`, or a code alone.
"""

import json
import math
import os
import sys
import time

# The SDK talks on standard output, from its import on.
REPORT = os.fdopen(os.dup(1), "w")
os.dup2(2, 1)

from xarm.wrapper import XArmAPI  # noqa: E402


def ready(arm, mode):
    return [arm.motion_enable(True), arm.set_mode(mode), arm.set_state(0), arm.get_state()]


def main(ip):
    reports = []
    arm = XArmAPI(ip, is_radian=True)
    arm.register_report_callback(lambda data: reports.append({**data, "at": time.monotonic()}))
    report = {
        "connected": arm.connected,
        "version": arm.get_version(),
        "serial": arm.get_robot_sn(),
        "axes": arm.axis,
        "before_enabling": {"state": arm.get_state(), "refused": arm.set_servo_angle(servo_id=1, angle=0.1, wait=False)},
        "angles": arm.get_servo_angle(is_real=True),
        "position": arm.get_position(),
        "clean": [arm.clean_error(), arm.clean_warn()],
        "ready": ready(arm, 0),
    }

    start = arm.get_servo_angle()[1][:6]
    goal = [start[0] + 0.3, start[1], start[2], start[3] - 0.2, start[4], start[5]]
    begun = time.monotonic()
    code = arm.set_servo_angle(angle=goal, speed=0.6, mvacc=6.0, wait=True)
    report["joint_motion"] = {
        "code": code,
        "seconds": time.monotonic() - begun,
        "goal": goal,
        "reached": arm.get_servo_angle()[1][:6],
    }
    report["kinematics"] = {
        "forward": arm.get_forward_kinematics(goal),
        "position": arm.get_position(),
        "inverse": arm.get_inverse_kinematics(arm.get_position()[1]),
    }
    # What the vendor's manual gives as an example of the arm at zero.
    report["forward_at_zero"] = arm.get_forward_kinematics([0, 0, 0, 0, 0, 0])

    target = list(arm.get_position()[1])
    target[2] += 40
    code = arm.set_position(*target, speed=100, mvacc=1000, wait=True)
    report["line"] = {"code": code, "goal": target, "reached": arm.get_position()[1]}

    report["servo_ready"] = ready(arm, 1)
    centre = arm.get_servo_angle()[1][:6]
    codes, angles = set(), []
    for tick in range(100):
        wanted = list(centre)
        wanted[5] += 0.2 * math.sin(2 * math.pi * tick / 100)
        codes.add(arm.set_servo_angle_j(wanted))
        angles.append(arm.angles[5])
        time.sleep(0.01)
    time.sleep(0.4)
    report["servo_motion"] = {
        "codes": sorted(codes),
        "centre": centre[5],
        "reached": arm.get_servo_angle()[1][5],
    }

    report["emergency_stop"] = {"ready": ready(arm, 0)}
    moving = list(centre)
    moving[0] -= 1.5
    arm.set_servo_angle(angle=moving, speed=0.5, wait=False)
    time.sleep(0.5)
    report["emergency_stop"]["state_while_moving"] = arm.get_state()
    arm.emergency_stop()
    time.sleep(0.2)
    stopped = arm.get_servo_angle()[1][0]
    time.sleep(0.3)
    report["emergency_stop"].update(
        state=arm.get_state(),
        refused=arm.set_servo_angle(angle=centre, wait=False),
        way=stopped - centre[0],
        crept=arm.get_servo_angle()[1][0] - stopped,
        ready_again=[arm.clean_error(), *ready(arm, 0)],
        back=arm.set_servo_angle(angle=centre, speed=1.0, wait=True),
        angle=arm.get_servo_angle()[1][0] - centre[0],
    )

    report["settings"] = {
        "load": arm.set_tcp_load(0.6, [0, 0, 50]),
        "sensitivity": arm.set_collision_sensitivity(4),
        "reduced": [arm.set_reduced_max_joint_speed(1.0), arm.set_reduced_mode(True), arm.get_reduced_states()],
        "ready": ready(arm, 0),
        "errors": arm.get_err_warn_code(),
    }
    time.sleep(0.6)
    report["reports"] = {
        "count": len(reports),
        "per_s": (len(reports) - 1) / (reports[-1]["at"] - reports[0]["at"]),
        "last": {key: reports[-1][key] for key in ("joints", "cartesian", "state", "error_code", "mtbrake")},
        "load": arm.tcp_load,
        "sensitivity": arm.collision_sensitivity,
        "reduced": arm.is_reduced_mode,
        "voltages": arm.voltages,
        "temperatures": arm.temperatures,
    }
    arm.set_reduced_mode(False)
    arm.disconnect()

    for kind in ("real", "normal"):
        arm, times = XArmAPI(ip, is_radian=True, report_type=kind), []
        arm.register_report_location_callback(lambda data: times.append(time.monotonic()))
        time.sleep(1.5)
        report[f"{kind}_reports"] = {"per_s": (len(times) - 1) / (times[-1] - times[0]), "angles": arm.angles}
        arm.disconnect()
    return report


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python use_arm.py IP")
    json.dump(main(sys.argv[1]), REPORT, indent=1)
    REPORT.close()
