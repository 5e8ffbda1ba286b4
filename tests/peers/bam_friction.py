"""BAM's friction models M1 to M6, fitted on the logs of `palpate bench servos`.

Of Duclusaud, Passault and others, "Extended Friction Models for the Physics Simulation of Servo Actuators", arXiv
2410.08650. Written from the paper's equations and stepped as in the authors' simulator: semi-implicit, friction as the
torque that would stop the joint within a step, up to the budget of the model. As the authors do, CMA-ES with restarts
lowers the mean absolute position error of open-loop rollouts, within the bounds that they give for this servo.

Reads one line of JSON and writes one: the mean absolute error of each held-out log, by model and fold.
"""

import json
import sys

import cma
import numpy as np
from numba import njit

GRAVITY = 9.80665
# Whether friction depends on the load, on which side loads it, on how slow the joint is, and on the square of the load.
MODELS = {
    "M1": (False, False, False, False),
    "M2": (False, False, True, False),
    "M3": (True, False, False, False),
    "M4": (True, False, True, False),
    "M5": (True, True, True, False),
    "M6": (True, True, True, True),
}
# Torque constant, resistance, armature, offset, Coulomb, viscous; Stribeck; load by motor and load, the same at rest;
# speed and exponent of the Stribeck curve; square of the load by motor and load.
NAMES = [
    "kt", "R", "armature", "offset", "base", "viscous", "stribeck", "motor", "external", "motor_stribeck",
    "external_stribeck", "speed", "alpha", "motor_quad", "external_quad",
]  # fmt: skip
BOUNDS = {
    "kt": (0.1, 3.0), "R": (2.0, 5.0), "armature": (1e-4, 0.05), "offset": (-0.1, 0.1), "base": (0.0, 0.2),
    "viscous": (0.0, 1.0), "stribeck": (0.0, 0.2), "motor": (0.0, 0.5), "external": (0.0, 0.5),
    "motor_stribeck": (0.0, 1.0),
    "external_stribeck": (0.0, 1.0), "speed": (0.1, 3.0), "alpha": (1.0, 10.0), "motor_quad": (0.0, 0.01),
    "external_quad": (0.0, 0.01),
}  # fmt: skip
EVALUATIONS = 12_000
RESTARTS = 2


@njit(cache=False)
def error(p, times, goals, torque, positions, gain, supply, mass, length, start):
    kt, resistance, armature, offset, base, viscous = p[0], p[1], p[2], p[3], p[4], p[5]
    stribeck, motor, external, motor_stribeck, external_stribeck = p[6], p[7], p[8], p[9], p[10]
    speed, alpha, motor_quad, external_quad = p[11], p[12], p[13], p[14]
    inertia = mass * length * length + armature
    q, dq = start[0], start[1]
    total = abs(q - positions[0])
    for i in range(1, len(times)):
        dt = times[i] - times[i - 1]
        duty = min(1.0, max(-1.0, gain * (goals[i - 1] - q)))
        by_motor = kt / resistance * (duty * supply - kt * dq) if torque[i - 1] else 0.0
        by_load = -mass * GRAVITY * length * np.sin(q + offset)
        slow = np.exp(-(abs(dq / speed) ** alpha))
        budget = base + abs(by_load * external - by_motor * motor)
        budget += slow * (stribeck + abs(by_load * external_stribeck - by_motor * motor_stribeck))
        if by_load * by_motor < 0.0:
            if abs(by_load) < abs(by_motor):
                budget += slow * external_quad * by_load * by_load
            else:
                budget += slow * motor_quad * by_motor * by_motor
        net = by_motor + by_load
        stop = inertia / dt * dq + net
        net -= np.sign(stop) * min(abs(stop), budget + viscous * abs(dq))
        dq = min(100.0, max(-100.0, dq + net / inertia * dt))
        q += dq * dt
        total += abs(q - positions[i])
    return total / len(times)


def full(model, free, values):
    """All parameters from those that `model` has; one load friction stands for both sides."""
    load_dependent, directional, slow, quadratic = MODELS[model]
    by_name = dict.fromkeys(NAMES, 0.0) | {"speed": 0.2, "alpha": 1.35}
    by_name |= dict(zip(free, values, strict=True))
    if load_dependent and not directional:
        by_name["external"] = by_name["motor"]
        by_name["external_stribeck"] = by_name["motor_stribeck"]
    return np.array([by_name[name] for name in NAMES])


def free_parameters(model):
    load_dependent, directional, slow, quadratic = MODELS[model]
    free = ["kt", "R", "armature", "offset", "base", "viscous"]
    free += ["stribeck", "speed", "alpha"] if slow else []
    free += ["motor"] if load_dependent else []
    free += ["external"] if directional else []
    free += ["motor_stribeck"] if load_dependent and slow else []
    free += ["external_stribeck"] if directional and slow else []
    free += ["motor_quad", "external_quad"] if quadratic else []
    return free


def fit(model, logs, seed):
    free = free_parameters(model)
    lower, upper = (np.array([BOUNDS[name][end] for name in free]) for end in (0, 1))

    def objective(at):
        values = full(model, free, lower + np.clip(at, 0.0, 1.0) * (upper - lower))
        return sum(error(values, *log) for log in logs) / len(logs)

    options = {"bounds": [0, 1], "maxfevals": EVALUATIONS, "seed": seed, "verbose": -9}
    best, _ = cma.fmin2(
        objective, 0.3 * np.ones(len(free)), 0.3, options, restarts=RESTARTS, bipop=True
    )
    return full(model, free, lower + np.clip(best, 0.0, 1.0) * (upper - lower))


inputs = json.loads(sys.stdin.readline())
logs = [
    tuple(np.array(log[name]) for name in ("times_s", "goals_rad", "torque_on", "positions_rad"))
    + tuple(log[name] for name in ("gain_per_rad", "supply_v", "mass_kg", "length_m"))
    + (np.array(log["start"]),)
    for log in inputs["logs"]
]
errors = {}
for model in MODELS:
    errors[model] = []
    for fold in inputs["folds"]:
        held_out = set(fold)
        fitted = fit(model, [log for idx, log in enumerate(logs) if idx not in held_out], inputs["seed"])
        errors[model].append([error(fitted, *logs[idx]) for idx in fold])
print(json.dumps({"errors_rad": errors}))
