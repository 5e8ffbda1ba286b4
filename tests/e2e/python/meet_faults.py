"""Meets faults of the emulated devices as the vendors' SDKs report them.

    pip install dynamixel-sdk xarm-python-sdk
    python meet_faults.py DIR PORT IP

Writes `faults.toml` into DIR, looks at servos and arm, and prints one JSON document of what the SDKs said.
"""

import json
import os
import sys
import time

# The SDK of the arm talks on standard output, from its import on.
REPORT = os.fdopen(os.dup(1), "w")
os.dup2(2, 1)

from dynamixel_sdk import PacketHandler, PortHandler, port_handler  # noqa: E402
from xarm.wrapper import XArmAPI  # noqa: E402

# The SDK's own setting, ms: a busy machine runs the emulation later than an adapter would answer.
port_handler.LATENCY_TIMER = 100

TORQUE, HARDWARE_ERROR, TEMPERATURE = 64, 70, 146


def wait_for(condition, seconds=10.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "a fault does not show"
        time.sleep(0.05)


def main(folder, path, ip):
    file = os.path.join(folder, "faults.toml")

    def faults(text):
        # Whole at once: a file that is read while it is written would be a mistake in itself.
        with open(file + ".new", "w", encoding="utf-8") as new:
            new.write(text)
        os.replace(file + ".new", file)

    port, servos = PortHandler(path), PacketHandler(2.0)
    assert port.openPort() and port.setBaudRate(4_000_000)
    report = {"torque_on": servos.write1ByteTxRx(port, 2, TORQUE, 1)}
    faults('[[fault]]\nkind = "overload"\njoint = "index_pip"\n')
    wait_for(lambda: servos.read1ByteTxRx(port, 2, HARDWARE_ERROR)[0] != 0)
    report["overloaded"] = {
        "hardware_error": servos.read1ByteTxRx(port, 2, HARDWARE_ERROR),
        "torque": servos.read1ByteTxRx(port, 2, TORQUE),
        "says": servos.getRxPacketError(servos.read1ByteTxRx(port, 2, TORQUE)[2]),
        "neighbour": servos.read1ByteTxRx(port, 1, HARDWARE_ERROR),
    }
    faults("")
    time.sleep(0.3)
    report["still_tripped"] = servos.read1ByteTxRx(port, 2, HARDWARE_ERROR)
    servos.reboot(port, 2)
    time.sleep(0.5)
    report["after_reboot"] = servos.read1ByteTxRx(port, 2, HARDWARE_ERROR)

    cold = servos.read1ByteTxRx(port, 5, TEMPERATURE)[0]
    faults('[[fault]]\nkind = "heating"\njoint = "middle_mcp_forward"\nrise_k = 25.0\n')
    wait_for(lambda: servos.read1ByteTxRx(port, 5, TEMPERATURE)[0] >= cold + 24)

    faults('[[fault]]\nkind = "lost"\ndevice = "u2d2"\nshare = 0.5\n')
    wait_for(lambda: servos.ping(port, 3)[1] != 0)
    results = [servos.ping(port, 3)[1] for _ in range(40)]
    report["half_lost"] = {"good": results.count(0), "timed_out": results.count(-3001), "all": len(results)}
    faults("")
    wait_for(lambda: all(servos.ping(port, 3)[1] == 0 for _ in range(5)))
    port.closePort()

    arm = XArmAPI(ip, is_radian=True)
    codes = []
    arm.register_error_warn_changed_callback(lambda data: codes.append(data["error_code"]))

    def make_ready():
        return [arm.motion_enable(True), arm.set_mode(0), arm.set_state(0), arm.get_state()]

    report["ready"] = make_ready()
    angle = arm.get_servo_angle()[1][0]
    for name, kind in (("collision", "collision"), ("emergency_stop", "emergency_stop")):
        arm.set_servo_angle(servo_id=1, angle=angle + 1.5, speed=0.3, wait=False)
        time.sleep(0.3)
        faults(f'[[fault]]\nkind = "{kind}"\n')
        wait_for(lambda: arm.error_code != 0)
        time.sleep(0.4)
        stopped = arm.get_servo_angle()[1][0]
        report[name] = {
            "error": arm.get_err_warn_code(),
            "state": arm.get_state(),
            "refused": arm.set_servo_angle(servo_id=1, angle=angle, wait=False),
            "way": stopped - angle,
        }
        # Cleared while the cause is there, then without it.
        arm.clean_error()
        time.sleep(0.1)
        report[name]["cleared_too_soon"] = arm.get_err_warn_code()
        faults("")
        time.sleep(0.3)
        arm.clean_error()
        report[name]["cleared"] = arm.get_err_warn_code()
        report[name]["ready"] = make_ready()
        report[name]["back"] = arm.set_servo_angle(servo_id=1, angle=angle, speed=1.0, wait=True)
    report["told"] = codes
    arm.disconnect()
    return report


if __name__ == "__main__":
    if len(sys.argv) != 4:
        sys.exit("usage: python meet_faults.py DIR PORT IP")
    json.dump(main(*sys.argv[1:]), REPORT, indent=1)
    REPORT.close()
