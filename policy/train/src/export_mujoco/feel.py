"""Runs the scene while the hand follows a script, and prints what it feels.

Needs Python 3.11, mujoco, and palpate with its library: README.md says how to install them.
"""

import tomllib
from pathlib import Path

import mujoco
import numpy as np

from palpate.touch import Touch

HERE = Path(__file__).resolve().parent
RATE_HZ = {rate_hz}

model = mujoco.MjModel.from_xml_path(str(HERE / "scene.xml"))
data = mujoco.MjData(model)
mujoco.mj_resetDataKeyframe(model, data, model.key("start").id)

touch = Touch(
    HERE / "{station}",
    HERE / "object.toml",
    HERE / "model.toml",
    fixed=[(HERE / "table.toml", {table_pose})],
)
joints = np.array([model.joint(name).qposadr[0] for name in touch.joints])
actuators = np.array([model.actuator(name).id for name in touch.joints])
object_at = model.joint("object").qposadr[0]

# The script: joints that a key names go there until its time, linearly; the others stay.
keys = tomllib.loads((HERE / "script.toml").read_text())["key"]
times_s, targets = [0.0], [data.qpos[joints].copy()]
for key in keys:
    target = targets[-1].copy()
    for name, position in key.get("joints", {}).items():
        target[touch.joints.index(name)] = position
    times_s.append(key["at_s"])
    targets.append(target)
targets = np.array(targets)

steps = round(1.0 / RATE_HZ / model.opt.timestep)
while data.time < times_s[-1] + 0.5:
    readings = touch.step(data.time, data.qpos[joints], data.qpos[object_at : object_at + 7])
    on = [touch.channels[idx] for idx in np.flatnonzero(readings.active[0])]
    height_mm = 1e3 * data.qpos[object_at + 2]
    print(f"{data.time:.2f} s, object at {height_mm:.0f} mm: {', '.join(on) or 'nothing'}")
    data.ctrl[actuators] = [np.interp(data.time, times_s, of_joint) for of_joint in targets.T]
    mujoco.mj_step(model, data, steps)
