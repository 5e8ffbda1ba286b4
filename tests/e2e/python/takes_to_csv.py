"""Writes a session's takes as the CSV folders that `palpate import` reads, with third-party readers only.

Usage: takes_to_csv.py SESSION_DIR OUT_DIR
"""

import csv
import sys
import tomllib
from pathlib import Path

from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory


def seconds(timestamp):
    return timestamp.seconds + timestamp.nanos * 1e-9


def export(take_path, out_dir):
    joints, streams, markers, meta = [], {}, [], {}
    with take_path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for metadata in reader.iter_metadata():
            if metadata.name == "palpate.take":
                meta = dict(metadata.metadata)
        for _schema, channel, message, decoded in reader.iter_decoded_messages():
            if channel.topic == "/joint_states":
                joints.append((message.log_time, [joint.position for joint in decoded.joints]))
            elif channel.topic.startswith("/tactile/"):
                name = channel.topic.removeprefix("/tactile/")
                streams.setdefault(name, []).append((message.log_time, list(decoded.raw)))
            elif channel.topic == "/markers":
                markers.append((decoded.kind, seconds(decoded.start), seconds(decoded.end)))
    start_ns = min(joints[0][0], *(samples[0][0] for samples in streams.values()))
    out_dir.mkdir(parents=True)

    def write(name, header, rows):
        with (out_dir / name).open("w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(header)
            for time_ns, values in rows:
                writer.writerow([f"{(time_ns - start_ns) * 1e-9:.9f}", *(f"{value:.9g}" for value in values)])

    write("joints.csv", ["t_s", *(f"q{i}" for i in range(len(joints[0][1])))], joints)
    for name, samples in streams.items():
        write(f"{name}.csv", ["t_s", *(f"v{i}" for i in range(len(samples[0][1])))], samples)

    start_s = start_ns * 1e-9
    spans = {
        kind: [[max(0.0, a - start_s), b - start_s] for k, a, b in markers if k == kind] for kind in (1, 2)
    }
    return meta, spans


def main():
    session_dir, out_dir = Path(sys.argv[1]), Path(sys.argv[2])
    session = tomllib.loads((session_dir / "session.toml").read_text())
    for take in session["take"]:
        path = session_dir / take["file"]
        folder = out_dir / path.stem
        meta, spans = export(path, folder)
        position = [float(number) for number in meta["object_position_m"].split()]
        quaternion = [float(number) for number in meta["object_quaternion_wxyz"].split()]
        lines = [
            f'object = "{meta["object"]}"',
            f"object_pose = {{ position_m = {position}, quaternion_wxyz = {quaternion} }}",
            f'primitive = "{meta["primitive"]}"',
            f"repetitions_s = {spans[2]}",
            f"baseline_s = {spans[1][0]}",
            "binary = false",
            "fixture_trusted = true",
        ]
        (folder / "take.toml").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
