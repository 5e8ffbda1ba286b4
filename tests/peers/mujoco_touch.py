"""Measures `palpate.touch` beside MuJoCo's own touch sensors, on the same states of the same scene.

    palpate-train export-mujoco --out cube_for_mujoco --object cube --model assets/models/demo_diagnosed.toml
    python tests/peers/mujoco_touch.py cube_for_mujoco        # Python 3.11 with numpy, mujoco and palpate

The hand of the exported scene closes around the object as the script beside it says, from 64 starts of the object; two
seconds of it count, from when the hand is down, at 20 frames a second. 4,096 environments go through these states, each
from a start and a frame of its own. MuJoCo has a touch sensor for each channel: a site at its taxel. A step of an
environment is

    palpate       readings of every channel from joint positions and the object's pose, with what effects remember
    sensors       mj_sensorAcc alone: contacts and their forces are there already
    forward       mj_forward: contacts, forces and sensors of a state

Everything runs on as many threads as there are cores, in turns; the least processor time of each counts, and the least
time on the clock. Prints environment steps a second of both.
"""

import argparse
import os
import time
import tomllib
import xml.etree.ElementTree as ElementTree
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import mujoco
import numpy as np

from palpate.touch import Touch

ENVS, STARTS, BEGIN_S, SPAN_S, RATE_HZ = 4096, 64, 2.0, 2.0, 20.0
RADIUS_M = 0.005


def with_sensors(xml: str, numbers: dict) -> str:
    """`xml` with a touch sensor for each channel."""
    tree = ElementTree.fromstring(xml)
    bodies = {body.get("name"): body for body in tree.iter("body")}
    sensors = ElementTree.SubElement(tree, "sensor")
    for patch in numbers["patches"]:
        first, end = patch["channels"]
        nodes = np.array(patch["nodes"])
        if patch["weights"]:
            nearest = np.argmax(np.array(patch["weights"]).reshape(len(nodes), end - first), axis=0)
            places, radius = nodes[nearest], RADIUS_M
        else:
            places, radius = [np.array(patch["center"])], patch["radius_m"]
        for channel, place in enumerate(places, first):
            name = numbers["names"]["channels"][channel]
            at = {"name": name, "pos": " ".join(map(str, place)), "size": str(radius)}
            ElementTree.SubElement(bodies[numbers["links"][patch["link"]]["name"]], "site", at)
            ElementTree.SubElement(sensors, "touch", {"site": name})
    return ElementTree.tostring(tree, encoding="unicode")


def threads_share(work, items: list, pool: ThreadPoolExecutor, num: int) -> None:
    """`work` on each of `items`, a part of them on each thread."""
    list(pool.map(lambda part: [work(item) for item in part], [items[i::num] for i in range(num)]))


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("--rounds", type=int, default=5)
    args = parser.parse_args()
    folder, num_threads = args.folder, len(os.sched_getaffinity(0))
    station = next((folder / "station").rglob("stations/*.toml"), None) or next((folder / "station").glob("*.toml"))
    lines = (line.strip() for line in (folder / "feel.py").read_text().splitlines())
    table_pose = next(line.split('"table.toml", ')[1].rstrip("]),") for line in lines if '"table.toml"' in line)
    fixed = [(folder / "table.toml", np.array([float(number) for number in table_pose.strip("[").split(",")]))]

    def touch_of(model: Path | None, envs: int) -> Touch:
        return Touch(station, folder / "object.toml", model, envs=envs, fixed=fixed)

    first = touch_of(folder / "model.toml", 1)
    model = mujoco.MjModel.from_xml_string(with_sensors((folder / "scene.xml").read_text(), first.numbers()))
    joints = np.array([model.joint(name).qposadr[0] for name in first.joints])
    actuators = np.array([model.actuator(name).id for name in first.joints])
    object_at = model.joint("object").qposadr[0]
    keys = tomllib.loads((folder / "script.toml").read_text())["key"]
    substeps, frames = round(1.0 / RATE_HZ / model.opt.timestep), round(SPAN_S * RATE_HZ)

    # States of all starts and frames.
    generator = np.random.default_rng(1)
    positions, poses = np.empty((STARTS, frames, len(joints))), np.empty((STARTS, frames, 7))
    felt = np.zeros((2, frames))
    for start in range(STARTS):
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, 0)
        data.qpos[object_at : object_at + 2] += generator.uniform(-0.01, 0.01, 2)
        times_s, targets = [0.0], [data.qpos[joints].copy()]
        for key in keys:
            targets.append(targets[-1].copy())
            times_s.append(key["at_s"])
            for name, position in key.get("joints", {}).items():
                targets[-1][first.joints.index(name)] = position
        way = np.array(targets).T
        frame = 0
        while frame < frames:
            mujoco.mj_forward(model, data)
            if data.time >= BEGIN_S - 1e-9:
                positions[start, frame], poses[start, frame] = data.qpos[joints], data.qpos[object_at : object_at + 7]
                felt[0, frame] += np.count_nonzero(data.sensordata)
                frame += 1
            data.ctrl[actuators] = [np.interp(data.time, times_s, of_joint) for of_joint in way]
            mujoco.mj_step(model, data, substeps)
    datas = [mujoco.MjData(model) for _ in range(STARTS)]

    def set_states(frame: int) -> None:
        for start, data in enumerate(datas):
            data.qpos[joints], data.qpos[object_at : object_at + 7] = positions[start, frame], poses[start, frame]
            data.qvel[:] = 0.0
            data.ctrl[actuators] = positions[start, frame]
            mujoco.mj_forward(model, data)

    # Environment i is in frame (i // STARTS + step) of start i % STARTS.
    starts, offsets = np.arange(ENVS) % STARTS, np.arange(ENVS) // STARTS
    models = {"palpate, theta alone": None, "palpate, diagnosed": folder / "model.toml"}
    touches = {name: touch_of(model, ENVS) for name, model in models.items()}
    pool = ThreadPoolExecutor(num_threads)
    repeats = ENVS // STARTS

    def palpate(touch: Touch) -> None:
        touch.restart()
        for step in range(frames):
            at = (offsets + step) % frames
            readings = touch.step(step / RATE_HZ, positions[starts, at], poses[starts, at])
            felt[1, step] = np.count_nonzero(readings.active)

    def mujoco_of(work) -> None:
        """As many environment steps as `palpate` has in a round: each of the states of a frame `repeats` times."""
        for frame in range(frames):
            set_states(frame)
            begin()
            threads_share(lambda data: [work(model, data) for _ in range(repeats)], datas, pool, num_threads)
            end()

    spent = [0.0, 0.0]
    begun = [0.0, 0.0]

    def begin() -> None:
        begun[:] = [time.process_time(), time.perf_counter()]

    def end() -> None:
        spent[0] += time.process_time() - begun[0]
        spent[1] += time.perf_counter() - begun[1]

    def timed_palpate(touch: Touch) -> None:
        begin()
        palpate(touch)
        end()

    rounds = {name: lambda touch=touch: timed_palpate(touch) for name, touch in touches.items()}
    rounds["MuJoCo, sensors"] = lambda: mujoco_of(mujoco.mj_sensorAcc)
    rounds["MuJoCo, forward"] = lambda: mujoco_of(mujoco.mj_forward)
    least: dict[str, np.ndarray] = {}
    for _ in range(args.rounds):
        for name, work in rounds.items():
            spent[:] = [0.0, 0.0]
            work()
            least[name] = np.minimum(least.get(name, np.inf), spent)
    steps = ENVS * frames
    print(f"{ENVS} environments, {len(first.channels)} channels, {frames} frames, {num_threads} threads")
    print(f"MuJoCo feels {felt[0].sum() / STARTS / frames:.2f} channels a frame, palpate {felt[1].sum() / steps:.2f}")
    for name, (cpu_s, clock_s) in least.items():
        print(f"{name:24} {steps / cpu_s:12,.0f} a second of processor time {steps / clock_s:12,.0f} on the clock")


if __name__ == "__main__":
    main()
