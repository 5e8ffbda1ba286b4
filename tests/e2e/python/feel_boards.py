"""Reads the tactile boards as their own host programs do: lines of numbers between blanks.

    pip install pyserial
    python feel_boards.py SECONDS FSR_PORT TWINTAC_PORT...

Prints one JSON document: for each port its lines a second, how many values a line has, and their mean.
"""

import json
import sys
import threading
import time

import serial


def read(path, seconds, found):
    rows, bad = [], 0
    with serial.Serial(path, 115200, timeout=0.5) as port:
        port.readline()  # The first one may have begun before we came.
        begun = time.monotonic()
        while time.monotonic() - begun < seconds:
            try:
                rows.append([float(word) for word in port.readline().decode("ascii").split()])
            except ValueError:
                bad += 1
        took = time.monotonic() - begun
    widths = sorted({len(row) for row in rows if row})
    full = [row for row in rows if len(row) == widths[-1]] if widths else []
    found[path] = {
        "lines_per_s": len(rows) / took,
        "widths": widths,
        "bad": bad,
        "mean": [sum(column) / len(full) for column in zip(*full)],
        "most": [max(column) for column in zip(*full)],
    }


def main(seconds, paths):
    found = {}
    readers = [threading.Thread(target=read, args=(path, seconds, found)) for path in paths]
    for reader in readers:
        reader.start()
    for reader in readers:
        reader.join()
    return [found[path] for path in paths]


if __name__ == "__main__":
    if len(sys.argv) < 3:
        sys.exit("usage: python feel_boards.py SECONDS FSR_PORT TWINTAC_PORT...")
    json.dump(main(float(sys.argv[1]), sys.argv[2:]), sys.stdout)
    print()
