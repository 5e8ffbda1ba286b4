"""The sensor model in JAX feels what the library does, and refuses what it does not compute."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from takes import MODELS, STATION, RecordedTake

from palpate import PalpateError
from palpate.touch import Touch
from palpate.touch_jax import COVERED, TouchModel

WITHIN = 1e-5

# Streams have their own of what theta says, so that nothing takes the shared one.
THETA = """
[theta]
lambda_con_m = 0.004
alpha_per_m = 400.0
lambda_pre_pa = 30000.0

[stream.fsr]
lambda_con_m = 0.0005

[stream.twintac]
lambda_pre_pa = 9000.0

[response]
off_fractions = { fsr = 0.8, twintac = 0.7 }
"""

EFFECTS = {
    "joint_offset": ["where = { joint = 'middle_mcp_forward' }\nparameters = { offset_rad = 0.012 }"],
    "joint_backlash": [
        "where = { joint = 'index_pip' }\nparameters = { width_rad = 0.04 }",
        "where = { joint = 'thumb_mcp' }\nparameters = { width_rad = 0.03 }",
    ],
    "object_pose_offset": [
        "where = { object = 'cylinder_25x100mm' }\nparameters = { translation_x_m = 0.001, translation_y_m = -0.002, "
        "translation_z_m = 0.0015, rotation_x_rad = 0.05, rotation_y_rad = -0.03 }",
        "where = { object = 'sphere_50mm' }\nparameters = { translation_x_m = 0.002, translation_y_m = 0.001, "
        "translation_z_m = -0.001 }",
    ],
    "object_scale": ["where = { object = 'cylinder_25x100mm' }\nparameters = { factor = 1.03 }"],
    "sensor_mount_offset": [
        "where = { patch = 'middle_tip' }\n"
        "parameters = { translation_x_m = 0.001, translation_y_m = -0.001, rotation_rad = 0.2 }"
    ],
    "preload": [
        "where = { patch = 'index_tip' }\nparameters = { depth_m = 0.0002 }",
        "where = { patch = 'palm_heel' }\nparameters = { depth_m = 0.0004 }",
    ],
    "elastic_crosstalk": ["where = { patch = 'index_tip' }\nparameters = { decay_factor = 0.6 }"],
    "sensitivity_spread": [
        "where = { channel = 'index_tip.3' }\nparameters = { gain = 1.6 }",
        "where = { channel = 'thumb_tip.1' }\nparameters = { gain = 0.4 }",
    ],
    "creep": [
        "where = { stream = 'twintac' }\nparameters = { fraction = 0.2, time_constant_s = 0.5, exponent = 1.0 }",
        "where = { stream = 'fsr' }\nparameters = { fraction = 0.1, time_constant_s = 3.0, exponent = 2.5 }",
    ],
    "viscoelastic_release": [
        "where = { stream = 'twintac' }\nparameters = { fraction = 0.4, time_constant_s = 0.3 }",
        "where = { stream = 'fsr' }\nparameters = { fraction = 0.3, time_constant_s = 0.2 }",
    ],
    "low_pass": [
        "where = { stream = 'fsr' }\nparameters = { time_constant_s = 0.15 }",
        "where = { stream = 'twintac' }\nparameters = { time_constant_s = 0.05 }",
    ],
    "baseline_drift": ["where = { stream = 'twintac' }\nparameters = { rate_per_s = 0.004 }"],
    "threshold_hysteresis": ["where = { stream = 'fsr' }\nparameters = { off_fraction = 0.4 }"],
    "electrical_crosstalk": ["where = { stream = 'twintac' }\nparameters = { leak = 0.1 }"],
    "swapped_channels": ["where = { channels = ['middle_tip.2', 'middle_tip.5'] }\nparameters = { presence = 0.9 }"],
    "dead_channel": ["where = { channel = 'ring_tip.4' }\nparameters = { presence = 1.0 }"],
    "stuck_channel": ["where = { channel = 'ring_tip.0' }\nparameters = { presence = 1.0, level = 3.0 }"],
    "latency": [
        "where = { stream = 'fsr' }\nparameters = { delay_s = 0.17 }",
        "where = { stream = 'fsr' }\nparameters = { delay_s = 0.06 }",
        "where = { stream = 'twintac' }\nparameters = { delay_s = 0.21 }",
    ],
}


@pytest.fixture(autouse=True)
def double_precision() -> Iterator[None]:
    with jax.enable_x64(True):
        yield


def model_file(folder: Path, effects: dict[str, list[str]]) -> Path:
    entries = [f"[[effect]]\nid = '{effect}'\n{entry}\n" for effect, of in effects.items() for entry in of]
    path = folder / "model.toml"
    path.write_text("format = 3\nname = 'test'\n" + THETA + "\n".join(entries))
    return path


def compare(takes: list[RecordedTake], model: Path, library: Path) -> int:
    """Compares both over `takes`, and gives the number of events."""
    events = 0
    # Of one length, so that one program serves all takes of an object.
    frames = max(len(take.times_s) for take in takes)
    shortest_s = min(float(np.diff(take.times_s).min()) for take in takes)
    for name in sorted({take.object for take in takes}):
        touch = Touch(STATION, name, model, library=library)
        replay = jax.jit(TouchModel(touch, shortest_s).replay)
        for take in (take for take in takes if take.object == name):
            whole = touch.replay(take.times_s, take.positions, take.pose)
            more = frames - len(take.times_s)
            times_s = np.append(take.times_s, take.times_s[-1] + np.arange(1, more + 1))
            positions = np.concatenate([take.positions, np.repeat(take.positions[-1:], more, axis=0)])
            readings = replay(times_s, positions, take.pose)
            raw, active = np.asarray(readings.raw), np.asarray(readings.active)
            assert np.abs(raw[: len(take.times_s)] - whole.raw).max() < WITHIN
            assert np.array_equal(active[: len(take.times_s)], whole.active)
            events += int(np.count_nonzero(np.diff(whole.active, axis=0)))
    return events


@pytest.mark.parametrize("name", MODELS)
def test_the_demonstration_has_the_same_events_and_readings(
    name: str, demo_replays: dict[str, list[RecordedTake]], touch_library: Path
) -> None:
    assert compare(demo_replays[name], MODELS[name], touch_library) > 500


def test_every_effect_acts_as_in_the_library(
    demo_replays: dict[str, list[RecordedTake]], touch_library: Path, tmp_path: Path
) -> None:
    assert set(EFFECTS) == COVERED
    assert compare(demo_replays["nominal"], model_file(tmp_path, EFFECTS), touch_library) > 200


def test_many_environments_are_one_program(
    demo_replays: dict[str, list[RecordedTake]], touch_library: Path, tmp_path: Path
) -> None:
    """With what stands still, restarts, and no way back to Python."""
    take = demo_replays["nominal"][0]
    rod, block = tmp_path / "rod.toml", tmp_path / "block.toml"
    rod.write_text("id = 'rod'\nlabel = 'Rod'\nshape = { kind = 'capsule', radius_m = 0.047, length_m = 0.02 }")
    block.write_text("id = 'block'\nlabel = 'Block'\nshape = { kind = 'box', size_m = [0.09, 0.1, 0.09] }")
    beside = take.pose + np.array([0.0, 0.01, 0.005, 0.0, 0.0, 0.0, 0.0])
    tilted = np.append(take.pose[:3] - [0.0, 0.01, 0.0], [0.8, 0.0, 0.6, 0.0])
    fixed = [(rod, beside), (block, tilted)]
    envs, frames = 5, 40
    touch = Touch(STATION, take.object, MODELS["diagnosed"], envs=envs, fixed=fixed, library=touch_library)
    alone = Touch(STATION, take.object, MODELS["diagnosed"], envs=envs, library=touch_library)
    model = TouchModel(touch, 0.05)
    steps = jax.vmap(model.step)
    assert "callback" not in str(jax.make_jaxpr(steps)(*example(model, envs)))
    step = jax.jit(steps)
    states, *_ = example(model, envs)
    touched, by_others = 0, 0
    for frame in range(frames):
        times_s = 0.05 * np.full(envs, frame)
        positions = take.positions[80 + 90 * np.arange(envs) + frame]
        poses = np.tile(take.pose, (envs, 1))
        # Some objects slide a little, some are far away.
        poses[:, 0] += [0.0, 1e-4 * frame, 2e-4 * frame, 1.0, 1.0]
        if frame == 25:
            # Environment 3 begins again.
            states = jax.tree.map(lambda of, new: of.at[3].set(new), states, model.init())
            touch.restart(np.arange(envs) == 3)
        expected = touch.step(times_s, positions, poses)
        states, readings = step(states, times_s, positions, poses)
        assert np.abs(np.asarray(readings.raw) - expected.raw).max() < WITHIN
        assert np.array_equal(np.asarray(readings.active), expected.active)
        touched += int(expected.active.any(axis=1).sum())
        by_others += int((expected.active & ~alone.step(times_s, positions, poses).active).sum())
    assert touched > 30
    assert by_others > 30


def example(model: TouchModel, envs: int) -> tuple[object, jax.Array, jax.Array, jax.Array]:
    states = jax.vmap(lambda _: model.init())(jnp.arange(envs))
    pose = jnp.tile(jnp.array([0.0, 0.0, 9.0, 1.0, 0.0, 0.0, 0.0]), (envs, 1))
    return states, jnp.zeros(envs), jnp.zeros((envs, len(model.joints))), pose


@pytest.mark.parametrize(
    ("effect", "entry"),
    [
        ("rate_dependence", "where = { stream = 'fsr' }\nparameters = { damping_s = 0.03 }"),
        ("self_contact", "where = { groups = ['index', 'thumb'] }\nparameters = { presence = 1.0 }"),
        ("motion_artifact", "where = { stream = 'fsr' }\nparameters = { load_s_per_rad = 0.5 }"),
        ("integer_wrap", "where = { channel = 'ring_tip.0' }\nparameters = { presence = 1.0 }"),
        ("debounce", "where = { stream = 'fsr' }\nparameters = { min_on_s = 0.05 }"),
        ("clock_skew", "where = { stream = 'fsr' }\nparameters = { skew = 0.001 }"),
        ("sample_hold", "where = { stream = 'fsr' }\nparameters = { frozen_fraction = 0.2, span_s = 0.2 }"),
    ],
)
def test_an_effect_that_is_not_covered_is_refused_by_name(
    effect: str, entry: str, touch_library: Path, tmp_path: Path
) -> None:
    touch = Touch(STATION, "sphere_50mm", model_file(tmp_path, {effect: [entry]}), library=touch_library)
    assert touch.effects == (effect,)
    with pytest.raises(PalpateError, match=f"does not compute effect {effect} of model 'test'"):
        TouchModel(touch, 0.05)


def test_soft_pads_other_shapes_and_parts_are_refused_by_name(touch_library: Path, tmp_path: Path) -> None:
    soft = tmp_path / "soft.toml"
    soft.write_text("format = 3\nname = 'soft'\n" + THETA.replace("[response]", "[response]\npad_softness_m = 0.0003"))
    with pytest.raises(PalpateError, match=r"response\.pad_softness_m of model 'soft'"):
        TouchModel(Touch(STATION, "sphere_50mm", soft, library=touch_library), 0.05)
    with pytest.raises(PalpateError, match=r"objects of shape mesh .* object 'wedge_80mm'"):
        TouchModel(Touch(STATION, "wedge_80mm", library=touch_library), 0.05)
    stuck = {"stuck_channel": ["where = { channel = 'ring_tip.0' }\nparameters = { presence = 0.5 }"]}
    with pytest.raises(PalpateError, match=r"stuck_channel with a presence of 0\.5"):
        TouchModel(Touch(STATION, "sphere_50mm", model_file(tmp_path, stuck), library=touch_library), 0.05)


def test_a_history_that_is_too_short_shows(touch_library: Path) -> None:
    touch = Touch(STATION, "sphere_50mm", MODELS["diagnosed"], library=touch_library)
    away, still = np.array([0.0, 0.0, 9.0, 1.0, 0.0, 0.0, 0.0]), np.zeros((60, len(touch.joints)))
    times_s = 0.01 * np.arange(60)
    raw = np.asarray(jax.jit(TouchModel(touch, 0.1).replay)(times_s, still, away).raw)
    # All frames are there at first, and then those are lost that should be shown.
    assert np.isfinite(raw[:3]).all()
    assert np.isnan(raw[-1]).all()


def test_shapes_and_steps_that_cannot_be_are_refused(touch_library: Path) -> None:
    touch = Touch(STATION, "sphere_50mm", library=touch_library)
    for step_s in [0.0, float("nan")]:
        with pytest.raises(PalpateError, match="shortest_step_s"):
            TouchModel(touch, step_s)
    model = TouchModel(touch, 0.05)
    with pytest.raises(PalpateError, match=r"joint_positions has shape \(3,\), expected \(22,\)"):
        model.step(model.init(), 0.0, jnp.zeros(3), jnp.zeros(7))
