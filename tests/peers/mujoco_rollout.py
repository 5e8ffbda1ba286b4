"""MuJoCo's own `rollout` on the scene, starts and controls of `palpate-train bench`.

Reads the inputs as one line of JSON, then runs a round whenever it gets a line, and answers with its time and where the
objects ended.
"""

import json
import sys
import time

import mujoco
import numpy as np
from mujoco import rollout

inputs = json.loads(sys.stdin.readline())
model = mujoco.MjModel.from_xml_string(inputs["xml"])
full = mujoco.mjtState.mjSTATE_FULLPHYSICS
joint_adr = [model.joint(name).qposadr[0] for name in inputs["joints"]]
object_adr = model.joint(inputs["object"]).qposadr[0]

states = []
data = mujoco.MjData(model)
for positions, object_pose in inputs["starts"]:
    mujoco.mj_resetData(model, data)
    data.qpos[joint_adr] = positions
    data.qpos[object_adr : object_adr + 7] = object_pose
    mujoco.mj_forward(model, data)
    state = np.empty(mujoco.mj_stateSize(model, full))
    mujoco.mj_getState(model, data, state, full)
    states.append(state)
states = np.array(states)
controls = np.broadcast_to(np.array(inputs["controls"]), (len(states), len(inputs["controls"]), model.nu))
controls = np.ascontiguousarray(controls)
state_out = np.empty((len(states), controls.shape[1], states.shape[1]))
sensor_out = np.empty((len(states), controls.shape[1], model.nsensordata))
models = [model] * len(states)
datas = [mujoco.MjData(model) for _ in range(inputs["threads"])]

with rollout.Rollout(nthread=inputs["threads"]) as runner:
    for _ in sys.stdin:
        began, cpu_began = time.perf_counter(), time.process_time()
        runner.rollout(models, datas, states, controls, state=state_out, sensordata=sensor_out)
        seconds, cpu_seconds = time.perf_counter() - began, time.process_time() - cpu_began
        # A state begins with the time.
        objects = state_out[:, -1, 1 + object_adr : 4 + object_adr]
        print(json.dumps({"seconds": seconds, "cpu_seconds": cpu_seconds, "objects_m": objects.tolist()}), flush=True)
