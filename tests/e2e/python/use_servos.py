"""Uses the hand's servos with the vendor's own SDK, unchanged.

    pip install dynamixel-sdk
    python use_servos.py PORT

Finds, reads, sets up and moves servos and prints one JSON document of what came back: `[value, result, error]` for a
read, `[result, error]` for a write, as the SDK gives them.
"""

import json
import sys
import time

from dynamixel_sdk import (
    BROADCAST_ID,
    GroupBulkRead,
    GroupSyncRead,
    GroupSyncWrite,
    PacketHandler,
    PortHandler,
    port_handler,
)

# The SDK's own setting, ms: a busy machine runs the emulation later than an adapter would answer.
port_handler.LATENCY_TIMER = 100
BAUD = 4_000_000
FIRMWARE, OPERATING_MODE, TORQUE, LED = 6, 11, 64, 65
P_GAIN, D_GAIN, GOAL_CURRENT, GOAL_POSITION, PRESENT, VOLTAGE, TEMPERATURE = 84, 80, 102, 116, 126, 144, 146
MOVED, STEP = 4, 300


def little_endian(value, size):
    return list(value.to_bytes(size, "little", signed=True))


def signed(value, size):
    return value - (1 << 8 * size) if value >= 1 << 8 * size - 1 else value


def main(path):
    port, servos = PortHandler(path), PacketHandler(2.0)
    assert port.openPort() and port.setBaudRate(BAUD)
    found, result = servos.broadcastPing(port)
    ids = sorted(found)
    report = {
        "broadcast": {"result": result, "found": {servo: found[servo] for servo in ids}},
        "pings": [servos.ping(port, servo) for servo in ids],
        "nobody": servos.ping(port, 77),
        "firmware": servos.read1ByteTxRx(port, ids[0], FIRMWARE),
        "voltage": servos.read2ByteTxRx(port, ids[0], VOLTAGE),
        "temperature": servos.read1ByteTxRx(port, ids[0], TEMPERATURE),
    }

    # As the hand's own program begins: current-based position, gains, a bound for the current.
    modes = GroupSyncWrite(port, servos, OPERATING_MODE, 1)
    for servo in ids:
        assert modes.addParam(servo, [5])
    report["modes_written"] = modes.txPacket()
    report["modes"] = [servos.read1ByteTxRx(port, servo, OPERATING_MODE) for servo in ids]
    report["torque_on"] = [servos.write1ByteTxRx(port, servo, TORQUE, 1) for servo in ids]
    report["eeprom_while_torque_is_on"] = servos.write1ByteTxRx(port, MOVED, OPERATING_MODE, 3)
    report["beyond_the_limit"] = servos.write2ByteTxRx(port, MOVED, GOAL_CURRENT, 30_000)
    report["read_only"] = servos.write2ByteTxRx(port, MOVED, TEMPERATURE, 1)
    for address, value in [(P_GAIN, 600), (D_GAIN, 200), (GOAL_CURRENT, 350)]:
        write = GroupSyncWrite(port, servos, address, 2)
        for servo in ids:
            assert write.addParam(servo, little_endian(value, 2))
        assert write.txPacket() == 0
    report["gain"] = servos.read2ByteTxRx(port, MOVED, P_GAIN)

    states = GroupSyncRead(port, servos, PRESENT, 10)
    for servo in ids:
        assert states.addParam(servo)

    def state():
        result = states.txRxPacket()
        assert result == 0, servos.getTxRxResult(result)
        return [
            [signed(states.getData(servo, PRESENT + at, size), size) for at, size in ((0, 2), (2, 4), (6, 4))]
            for servo in ids
        ]

    before = state()
    goal = before[ids.index(MOVED)][2] + STEP
    report["goal_written"] = servos.write4ByteTxRx(port, MOVED, GOAL_POSITION, goal)
    on_the_way = []
    for _ in range(60):
        on_the_way.append(state()[ids.index(MOVED)])
        time.sleep(0.02)
    after = state()
    report["motion"] = {
        "goal": goal,
        "before": [position for _, _, position in before],
        "after": [position for _, _, position in after],
        "most_current_ma": max(abs(current) for current, _, _ in on_the_way),
        "most_velocity": max(velocity for _, velocity, _ in on_the_way),
        "positions": [position for _, _, position in on_the_way],
    }
    report["fast_sync_read"] = states.fastSyncRead()
    report["fast_positions"] = [signed(states.getData(servo, PRESENT + 6, 4), 4) for servo in ids]

    bulk = GroupBulkRead(port, servos)
    assert bulk.addParam(ids[0], VOLTAGE, 2) and bulk.addParam(ids[1], LED, 1)
    report["bulk_read"] = [bulk.txRxPacket(), bulk.getData(ids[0], VOLTAGE, 2), bulk.getData(ids[1], LED, 1)]
    report["registered"] = servos.regWriteTxRx(port, ids[1], LED, 1, [1])
    report["led_before_action"] = servos.read1ByteTxRx(port, ids[1], LED)
    report["action"] = servos.action(port, BROADCAST_ID)
    report["led_after_action"] = servos.read1ByteTxRx(port, ids[1], LED)
    report["factory_reset"] = servos.factoryReset(port, ids[1], 0xFF)
    report["reboot"] = servos.reboot(port, MOVED)
    time.sleep(0.5)
    report["torque_after_reboot"] = servos.read1ByteTxRx(port, MOVED, TORQUE)
    report["mode_after_reboot"] = servos.read1ByteTxRx(port, MOVED, OPERATING_MODE)
    report["torque_off"] = [servos.write1ByteTxRx(port, servo, TORQUE, 0) for servo in ids]
    port.closePort()
    return report


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python use_servos.py PORT")
    json.dump(main(sys.argv[1]), sys.stdout, indent=1)
    print()
