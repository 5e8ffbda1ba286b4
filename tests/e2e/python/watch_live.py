"""Watches a live station as a script of the Python client does, and says what came.

    python watch_live.py http://127.0.0.1:8080 SECONDS

Prints one JSON line when the first frame is there, and one document at the end: frames, the longest time between two by the station's
clock, frames that were lost on the way, and how many frames felt something.
"""

import json
import sys
import time

from palpate import Palpate


def main(url: str, seconds: float) -> dict:
    times_s: list[float] = []
    dropped = felt = 0
    with Palpate(url) as p:
        begun = None
        for frame in p.stream():
            if begun is None:
                begun = time.monotonic()
                print(json.dumps({"watching": True}), flush=True)
            times_s.append(frame.time_s)
            dropped = frame.dropped
            felt += bool(frame.felt())
            assert len(frame.raw) == len(frame.channels) and len(frame.joint_positions) == len(frame.joints)
            if time.monotonic() - begun > seconds:
                break
    steps = [after - before for before, after in zip(times_s, times_s[1:])]
    assert min(steps) > 0, "a frame came twice, or an older one after a newer one"
    return {
        "frames": len(times_s),
        "station_s": times_s[-1] - times_s[0],
        "longest_step_s": max(steps),
        "dropped": dropped,
        "felt": felt,
    }


if __name__ == "__main__":
    if len(sys.argv) != 3:
        raise SystemExit(__doc__)
    print(json.dumps(main(sys.argv[1], float(sys.argv[2]))))
