"""What `palpate.touch` computes, in JAX alone: for simulators that run as one program on an accelerator.

    from palpate.touch import Touch
    from palpate.touch_jax import TouchModel

    model = TouchModel(Touch(station, object, sensor_model), shortest_step_s=0.01)
    states = jax.vmap(lambda _: model.init())(jnp.arange(4096))
    states, readings = jax.jit(jax.vmap(model.step))(states, times_s, joint_positions, object_poses)

The library of `palpate.touch` is asked once, for the numbers; steps are JAX and nothing else, with `jit`, `vmap` and
`lax.scan`. They are computed in the precision that JAX is set to: with `jax_enable_x64` events are those of
`palpate.touch`; in single precision a threshold may be crossed a frame earlier or later. What is not covered is refused
by name: `COVERED` lists the effects that are. `docs/touch.md` has the rest.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jax.typing import ArrayLike
from numpy.typing import NDArray

from palpate.errors import PalpateError
from palpate.touch import Touch

COVERED = frozenset(
    {
        "joint_offset",
        "joint_backlash",
        "object_pose_offset",
        "object_scale",
        "sensor_mount_offset",
        "preload",
        "elastic_crosstalk",
        "sensitivity_spread",
        "creep",
        "viscoelastic_release",
        "low_pass",
        "baseline_drift",
        "threshold_hysteresis",
        "electrical_crosstalk",
        "swapped_channels",
        "dead_channel",
        "stuck_channel",
        "latency",
    }
)
"""Ids of the effects that `TouchModel` computes."""

_LAGGING = ("creep", "viscoelastic_release", "low_pass")
"""Those that remember what follows a load."""

SHAPES = frozenset({"sphere", "cylinder", "capsule", "box"})
"""Shapes that it knows the distance to."""

_ROUNDING_M = 1e-9
"""Room for rounding in the bound of a far patch, as the library has it."""

Floats = NDArray[np.float64]
Distance = Callable[[Array], Array]


class State(NamedTuple):
    """What one environment remembers from frame to frame."""

    frames: Array
    """How many there were."""
    start_s: Array
    before_s: Array
    joints: tuple[Array, ...]
    """Of each effect on joints, where the link is."""
    lags: tuple[Array, ...]
    """Of each effect that lags, 2 x channels: its input and where it is."""
    past_times_s: Array
    past_loads: Array
    """Frames that may still be shown, the newest last."""
    on: Array


class Readings(NamedTuple):
    """What one environment feels, as in `palpate.touch`."""

    raw: Array
    active: Array


class TouchModel:
    """A station's hand, an object and a sensor model in JAX, from those of `touch`.

    Args:
        touch: What to compute; its environments do not matter, and it may be closed afterwards.
        shortest_step_s: Shortest time between two frames, s. It says how many frames must be kept for streams that are
            late; with shorter steps the raw readings of such streams become NaN.

    """

    def __init__(self, touch: Touch, shortest_step_s: float) -> None:
        numbers = touch.numbers()
        names = numbers["names"]
        if not (math.isfinite(shortest_step_s) and shortest_step_s > 0.0):
            raise PalpateError("Bad input", f"shortest_step_s is {shortest_step_s}, expected a positive number of s")
        _check_covered(numbers)
        self.joints: tuple[str, ...] = tuple(names["joints"])
        """Names of the joints, in the order of positions."""
        self.channels: tuple[str, ...] = tuple(names["channels"])
        """Ids of the channels, in the order of readings."""
        self._links = numbers["links"]
        self._patches = numbers["patches"]
        self._bodies = [(_distance_to(body), body["base_from_body"]) for body in numbers["bodies"]]
        self._effects = [_Effect(effect) for effect in numbers["effects"]]
        self._plain: bool = numbers["is_plain"]
        self._thresholds: Floats = np.array(names["thresholds"])
        self._reaches_m: Floats = np.array(numbers["reaches_m"])
        self._near_m: float = numbers["near_m"]
        self._proximity = np.zeros(len(self.channels), dtype=np.bool_)
        for patch in self._patches:
            self._proximity[slice(*patch["channels"])] = patch["kind"] == "proximity"
        switching = {name: np.array(values) for name, values in numbers["switching"].items()}
        self._on_loads: Floats = switching["on_loads"]
        self._off_loads: Floats = switching["on_loads"] * switching["off_fractions"]
        self._idle: Floats = switching["idle_activation"]
        self._passed: Floats = switching["passed_shares"]
        self._object: str = names["object"]
        self._needed_links = self._find_needed_links()
        # Per stream that is late, its channels and how late, by each effect.
        self._late = [
            (slice(*stream["channels"]), delays_s)
            for idx, stream in enumerate(names["streams"])
            if (delays_s := [of.parameters["delay_s"] for of in self._of("latency") if idx in of.streams])
        ]
        longest_s = max((sum(delays_s) for _, delays_s in self._late), default=0.0)
        self._kept = math.ceil(longest_s / shortest_step_s) + 2 if self._late else 0

    def init(self) -> State:
        """Of an environment in which nothing has happened yet; `jax.vmap` makes many."""
        zero, channels = jnp.zeros(()), len(self.channels)
        return State(
            frames=jnp.zeros((), dtype=jnp.int32),
            start_s=zero,
            before_s=zero,
            joints=tuple(zero for _ in self._of("joint_backlash")),
            lags=tuple(jnp.zeros((2, len(of.channels))) for of in self._of(*_LAGGING)),
            past_times_s=jnp.zeros(self._kept),
            past_loads=jnp.zeros((self._kept, channels)),
            on=jnp.zeros(channels, dtype=jnp.bool_),
        )

    def step(
        self, state: State, time_s: ArrayLike, joint_positions: ArrayLike, object_pose: ArrayLike
    ) -> tuple[State, Readings]:
        """The next frame of one environment.

        Args:
            state: From `init` or the step before.
            time_s: Time since the episode began, s; it goes up.
            joint_positions: One for each of `joints`, rad or m.
            object_pose: 7; x y z in m, then a quaternion, scalar first, in the robot's base.

        """
        time_s, positions = jnp.asarray(time_s, dtype=float), jnp.asarray(joint_positions, dtype=float)
        pose = jnp.asarray(object_pose, dtype=float)
        for name, array, shape in [
            ("time_s", time_s, ()),
            ("joint_positions", positions, (len(self.joints),)),
            ("object_pose", pose, (7,)),
        ]:
            if array.shape != shape:
                raise PalpateError(
                    "Bad input", f"{name} has shape {array.shape}, expected {shape}: of one environment, see jax.vmap"
                )
        first = state.frames == 0
        start_s, before_s = jnp.where(first, time_s, state.start_s), jnp.where(first, time_s, state.before_s)
        positions, joints = self._move_joints(first, state.joints, positions)
        signals = self._touch(positions, pose)
        state = state._replace(frames=state.frames + 1, start_s=start_s, before_s=time_s, joints=joints)
        if self._plain:
            near, strong = signals < self._thresholds, signals > self._thresholds
            return state, Readings(signals, jnp.where(self._proximity, near, strong))
        loads = jnp.where(self._proximity, jnp.maximum(self._reaches_m - signals, 0.0), signals)
        loads, lags = self._develop(first, state.lags, loads, time_s - start_s, time_s - before_s)
        loads, past_times_s, past_loads = self._carry(first, state, loads, time_s)
        on = (loads > self._on_loads) | (state.on & (loads > self._off_loads))
        active = jnp.asarray(self._passed * jnp.maximum(on, self._idle) > 0.5)
        raw = jnp.where(self._proximity, self._reaches_m - loads, loads)
        state = state._replace(lags=lags, past_times_s=past_times_s, past_loads=past_loads, on=on)
        return state, Readings(raw, active)

    def replay(self, times_s: ArrayLike, joint_positions: ArrayLike, object_pose: ArrayLike) -> Readings:
        """A whole take: n times, n x joints positions, and where the object stands throughout."""

        def step(state: State, frame: tuple[Array, Array]) -> tuple[State, Readings]:
            return self.step(state, frame[0], frame[1], object_pose)

        frames = (jnp.asarray(times_s, dtype=float), jnp.asarray(joint_positions, dtype=float))
        _, readings = lax.scan(step, self.init(), frames)
        return readings

    def _of(self, *ids: str) -> list[_Effect]:
        return [effect for effect in self._effects if effect.id in ids]

    def _find_needed_links(self) -> list[bool]:
        needed = [False] * len(self._links)
        for patch in self._patches:
            link: int | None = patch["link"]
            while link is not None:
                needed[link] = True
                link = self._links[link]["parent"]
        return needed

    def _move_joints(
        self, first: Array, memory: tuple[Array, ...], positions: Array
    ) -> tuple[Array, tuple[Array, ...]]:
        kept: list[Array] = []
        for effect in self._of("joint_offset", "joint_backlash"):
            at = positions[effect.dof]
            if effect.id == "joint_offset":
                positions = positions.at[effect.dof].set(at + effect.parameters["offset_rad"])
                continue
            half = 0.5 * effect.parameters["width_rad"]
            link = jnp.clip(jnp.where(first, at, memory[len(kept)]), at - half, at + half)
            kept.append(link)
            positions = positions.at[effect.dof].set(link)
        return positions, tuple(kept)

    def _touch(self, positions: Array, pose: Array) -> Array:
        """Per channel, signed distance in m or propagated pressure in Pa."""
        links = self._kinematics(positions)
        bodies = [self._object_pose(pose) if fixed is None else _pose(jnp.asarray(fixed)) for _, fixed in self._bodies]
        signals = []
        for patch in self._patches:
            rotation, place = links[patch["link"]]
            pressed = patch["kind"] == "pressure"
            nodes = jnp.asarray(np.array(patch["nodes"]).reshape(-1, 3), dtype=float)
            center = jnp.asarray(patch["center"], dtype=float)
            felt = None
            for (distance, _), (body, origin) in zip(self._bodies, bodies, strict=True):
                from_link, offset = body.T @ rotation, body.T @ (place - origin)
                of_body = distance(nodes @ from_link.T + offset)
                if not pressed:
                    bound = distance(from_link @ center + offset) - (patch["radius_m"] + _ROUNDING_M)
                    nearest = jnp.minimum(jnp.min(of_body), self._near_m)
                    of_body = jnp.where(bound > self._near_m, bound, nearest)
                felt = of_body if felt is None else jnp.minimum(felt, of_body)
            lost_m = 0.0
            for effect in self._of("preload"):
                if patch["id"] in [self._patches[idx]["id"] for idx in effect.patches]:
                    lost_m += effect.parameters["depth_m"]
            count = patch["channels"][1] - patch["channels"][0]
            if felt is None:
                raise AssertionError("a scene has an object")
            if not pressed:
                signals.append(jnp.broadcast_to(felt + lost_m, (count,)))
                continue
            stiffness = patch["stiffness_pa_per_m"]
            pressures = jnp.maximum(stiffness * jnp.maximum(-felt, 0.0) - lost_m * stiffness, 0.0)
            weights = jnp.asarray(np.array(patch["weights"]).reshape(-1, count), dtype=float)
            signals.append(pressures @ weights)
        return jnp.concatenate(signals)

    def _kinematics(self, positions: Array) -> list[tuple[Array, Array]]:
        """Rotation and place of every link in the base; of links that nothing needs, of the root."""
        poses: list[tuple[Array, Array]] = []
        for link, needed in zip(self._links, self._needed_links, strict=True):
            if link["parent"] is None or not needed:
                poses.append((jnp.eye(3), jnp.zeros(3)))
                continue
            rotation, place = poses[link["parent"]]
            to_joint, offset = _pose(np.array(link["parent_from_joint"]))
            place, rotation = place + rotation @ offset, rotation @ to_joint
            axis = np.array(link["axis"])
            if link["kind"] == "revolute":
                rotation = rotation @ _turn(axis, positions[link["dof"]])
            elif link["kind"] == "prismatic":
                place = place + rotation @ (axis * positions[link["dof"]])
            poses.append((rotation, place))
        return poses

    def _object_pose(self, pose: Array) -> tuple[Array, Array]:
        rotation, place = _pose(pose)
        for effect in self._of("object_pose_offset"):
            if effect.object != self._object:
                continue
            shift = [effect.parameters.get(f"translation_{axis}_m", 0.0) for axis in "xyz"]
            turn = np.array([effect.parameters.get(f"rotation_{axis}_rad", 0.0) for axis in "xyz"])
            place = place + jnp.asarray(shift, dtype=float)
            if (angle := float(np.linalg.norm(turn))) > 0.0:
                rotation = rotation @ _turn(turn / angle, jnp.asarray(angle, dtype=float))
        return rotation, place

    def _develop(
        self, first: Array, memory: tuple[Array, ...], loads: Array, elapsed_s: Array, gap_s: Array
    ) -> tuple[Array, tuple[Array, ...]]:
        """Loads as sensors and electronics make them, in the order of the chain."""
        kept: list[Array] = []
        for effect in self._effects:
            channels, parameters = effect.channels, effect.parameters
            own = loads[channels]
            if effect.id == "sensitivity_spread":
                gains = [parameters.get("gain", parameters.get(f"gain_{self.channels[idx]}")) for idx in channels]
                loads = loads.at[channels].set(own * jnp.asarray(gains, dtype=float))
            elif effect.id == "low_pass":
                lag = _lag(first, memory[len(kept)], own, gap_s, parameters["time_constant_s"])
                kept.append(lag)
                loads = loads.at[channels].set(lag[1])
            elif effect.id in ("creep", "viscoelastic_release"):
                # The load of a pad is a depth, with whose square force goes.
                exponents = parameters.get("exponent", np.where(self._proximity[channels], 2.0, 1.0))
                forces = _power(own, exponents)
                lag = _lag(first, memory[len(kept)], forces, gap_s, parameters["time_constant_s"])
                kept.append(lag)
                share = parameters["fraction"]
                creeps = effect.id == "creep"
                felt = forces + share * (lag[1] - forces) if creeps else jnp.maximum(forces, share * lag[1])
                loads = loads.at[channels].set(_power(felt, 1.0 / exponents))
            elif effect.id == "baseline_drift":
                per_s = parameters["rate_per_s"] * self._on_loads[channels]
                loads = loads.at[channels].set(own + per_s * elapsed_s)
            elif effect.id == "electrical_crosstalk":
                before = loads
                for channel, other in effect.neighbours:
                    loads = loads.at[channel].add(parameters["leak"] * before[other])
            elif effect.id == "swapped_channels":
                share = parameters["presence"]
                loads = loads.at[channels].set((1.0 - share) * own + share * own[::-1])
            elif effect.id == "dead_channel":
                loads = loads.at[channels].set(own * (1.0 - parameters["presence"]))
            elif effect.id == "stuck_channel":
                share = parameters["presence"]
                level = share * parameters["level"] * self._on_loads[channels]
                loads = loads.at[channels].set(own * (1.0 - share) + level)
        return loads, tuple(kept)

    def _carry(self, first: Array, state: State, loads: Array, time_s: Array) -> tuple[Array, Array, Array]:
        """Loads of the moments that readings show, and the frames that later ones may show."""
        if not self._late:
            return loads, state.past_times_s, state.past_loads
        # Before the first frame all was as in it, however long ago.
        long_ago_s = time_s - 1e3 * jnp.arange(self._kept, 0, -1, dtype=time_s.dtype)
        times_s = jnp.append(jnp.where(first, long_ago_s, state.past_times_s)[1:], time_s)
        past = jnp.where(first, loads, state.past_loads)
        past = jnp.concatenate([past[1:], loads[None]])
        for channels, delays_s in self._late:
            shown_s = time_s
            for delay_s in delays_s:
                shown_s = shown_s - delay_s
            after = jnp.sum(times_s <= shown_s)
            start, end = jnp.maximum(after - 1, 0), jnp.minimum(after, self._kept - 1)
            gap_s = times_s[end] - times_s[start]
            share = jnp.where(gap_s > 0.0, (shown_s - times_s[start]) / jnp.where(gap_s > 0.0, gap_s, 1.0), 0.0)
            shown = past[start, channels] + share * (past[end, channels] - past[start, channels])
            loads = loads.at[channels].set(jnp.where(after > 0, shown, jnp.nan))
        return loads, times_s, past


class _Effect:
    """An effect with its places looked up."""

    def __init__(self, effect: dict[str, Any]) -> None:
        self.id: str = effect["id"]
        self.parameters: dict[str, float] = effect["parameters"]
        self.channels = np.array(effect["channels"], dtype=np.int64)
        self.streams: list[int] = effect["streams"]
        self.patches: list[int] = effect["patches"]
        self.dof: int = -1 if effect["dof"] is None else effect["dof"]
        self.object: str | None = effect["object"]
        self.neighbours: list[list[int]] = effect["neighbours"]


def _check_covered(numbers: dict[str, Any]) -> None:
    """Refuses what would otherwise be left out."""
    problems = [f"effect {effect['id']}" for effect in numbers["effects"] if effect["id"] not in COVERED]
    problems += [
        f"effect {effect['id']} with a presence of {effect['parameters']['presence']}, between 0 and 1"
        for effect in numbers["effects"]
        if effect["id"] == "stuck_channel" and 0.0 < effect["parameters"]["presence"] < 1.0
    ]
    if numbers["pad_softness_m"] > 0.0:
        problems.append("response.pad_softness_m")
    problems += [f"objects of shape {body['shape']}" for body in numbers["bodies"] if body["shape"] not in SHAPES]
    if problems:
        raise PalpateError(
            "Not covered",
            f"palpate.touch_jax does not compute {', '.join(dict.fromkeys(problems))} of model "
            f"{numbers['names']['model']!r} and object {numbers['names']['object']!r}; palpate.touch does",
        )


def _distance_to(body: dict[str, Any]) -> Distance:
    """Signed distance of points (... x 3, in the body's frame) to its surface, m."""
    shape = body["shape"]

    def ball(points: Array) -> Array:
        return _norm(points) - float(body["radius_m"])

    def cylinder(points: Array) -> Array:
        radial = _norm(points[..., :2]) - body["radius_m"]
        axial = jnp.abs(points[..., 2]) - 0.5 * body["height_m"]
        outside = _norm(jnp.stack([jnp.maximum(radial, 0.0), jnp.maximum(axial, 0.0)], axis=-1))
        return outside + jnp.minimum(jnp.maximum(radial, axial), 0.0)

    def capsule(points: Array) -> Array:
        beyond = jnp.maximum(jnp.abs(points[..., 2]) - 0.5 * body["length_m"], 0.0)
        return _norm(points.at[..., 2].set(beyond)) - float(body["radius_m"])

    def box(points: Array) -> Array:
        beyond = jnp.abs(points) - 0.5 * np.array(body["size_m"])
        return _norm(jnp.maximum(beyond, 0.0)) + jnp.minimum(jnp.max(beyond, axis=-1), 0.0)

    return {"sphere": ball, "cylinder": cylinder, "capsule": capsule, "box": box}[shape]


def _norm(vectors: Array) -> Array:
    return jnp.sqrt(jnp.sum(vectors * vectors, axis=-1))


def _pose(values: ArrayLike) -> tuple[Array, Array]:
    """Rotation matrix and place of `x y z qw qx qy qz`."""
    pose = jnp.asarray(values, dtype=float)
    w, x, y, z = pose[3:] / _norm(pose[3:])
    rotation = jnp.stack(
        [
            jnp.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)]),
            jnp.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)]),
            jnp.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]),
        ]
    )
    return rotation, pose[:3]


def _turn(axis: Floats, angle: Array) -> Array:
    """Rotation matrix of a turn about a unit vector (Rodrigues' formula)."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    twice: Floats = cross @ cross
    return jnp.eye(3) + jnp.sin(angle) * cross + (1.0 - jnp.cos(angle)) * twice


def _power(loads: Array, exponents: ArrayLike) -> Array:
    """Loads and forces are 0 or more."""
    # Without the slope of a root at 0, which is infinite.
    return jnp.where(loads > 0.0, jnp.where(loads > 0.0, loads, 1.0) ** exponents, 0.0)


def _lag(first: Array, memory: Array, inputs: Array, gap_s: Array, time_constant_s: float) -> Array:
    """The exact solution of `y' = (x - y) / tau` for `x` linear in between: the inputs, and where the lag is."""
    before, follows = jnp.where(first, inputs, memory[0]), jnp.where(first, inputs, memory[1])
    behind = (inputs - before) / jnp.where(gap_s > 0.0, gap_s, 1.0) * time_constant_s
    moved = inputs - behind + (follows - before + behind) * jnp.exp(-gap_s / time_constant_s)
    return jnp.stack([inputs, jnp.where(gap_s > 0.0, moved, follows)])


__all__ = ["COVERED", "SHAPES", "Readings", "State", "TouchModel"]
