"""The viewer: robot, taxels and objects are where the station has them, and pictures show it."""

from __future__ import annotations

import base64
import os
import socket
import subprocess
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from conftest import CHECKOUT, arm_and_move, tool, until
from numpy.typing import NDArray
from PIL import Image

from palpate import Palpate, PalpateError, Station
from palpate.viser import EXPECTED, FELT, Viewer, object_mesh, plain_urdf, show

Picture = NDArray[np.int16]


def free_port() -> int:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return int(listener.getsockname()[1])


@pytest.fixture
def viewer(p: Palpate) -> Iterator[Viewer]:
    viewer = show(p, port=free_port())
    yield viewer
    viewer.close()


def picture(viewer: Viewer, text: str, name: str, folder: Path) -> Picture:
    """The viewer's page, once its controls show `text`: only what is left of them and below its first notice."""
    if "browser" in os.environ.get("PALPATE_SKIP", "").replace(",", " ").split():
        pytest.skip("PALPATE_SKIP names browser")
    browser = tool("PALPATE_BROWSER_TESTS", "the folder tests/e2e/browser with playwright-core installed")
    file = Path(os.environ.get("PALPATE_ARTIFACTS", folder)) / f"viser-{name}.png"
    done = subprocess.run(
        ["node", "viser.mjs", viewer.url, file, text], cwd=browser, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, f"no picture of {viewer.url}: {done.stderr}"
    return np.asarray(Image.open(file).convert("RGB")).astype(np.int16)[200:, :650]


def near(picture: Picture, colour: tuple[int, int, int], within: int = 60) -> int:
    """How many pixels have nearly this colour."""
    return int((np.abs(picture - np.array(colour)).max(axis=2) < within).sum())


def test_capsules_become_cylinders_with_balls_at_their_ends() -> None:
    capsule = '<geometry><capsule radius="0.1" length="0.4"/></geometry>'
    turned = f'<visual><origin xyz="1 2 3" rpy="1.5707963267948966 0 0"/>{capsule}</visual>'
    text = f'<robot name="r"><link name="a">{turned}</link><link name="b"><visual>{capsule}</visual></link></robot>'
    root = ElementTree.fromstring(plain_urdf(text.encode()))
    assert root.find(".//capsule") is None
    cylinders = root.findall(".//cylinder")
    assert [item.attrib for item in cylinders] == [{"radius": "0.1", "length": "0.4"}] * 2
    ends = []
    for visual in root.findall("link[@name='a']/visual"):
        origin = visual.find("origin")
        if visual.find("geometry/sphere") is not None and origin is not None:
            ends.append([float(number) for number in origin.attrib["xyz"].split()])
    # The z axis of the capsule is -y of the link.
    np.testing.assert_allclose(sorted(ends), [[1, 1.8, 3], [1, 2.2, 3]], atol=1e-9)
    assert len(root.findall("link[@name='b']/visual")) == 3


def test_objects_of_every_kind_have_their_size(tmp_path: Path) -> None:
    files = {
        f"../objects/{path.relative_to(CHECKOUT / 'assets/objects')}": path.read_bytes()
        for path in (CHECKOUT / "assets/objects").rglob("*")
        if path.is_file()
    }
    objects = [path for path in files if path.endswith(".toml")]
    files["../layouts/none.toml"] = b"stream = []\npatch = []"
    station = f'id="x"\nlabel="X"\nrobot="r"\nlayout="../layouts/none.toml"\njoints=[]\nstream=[]\nobjects={objects}'
    encoded = {path: base64.b64encode(data).decode() for path, data in files.items()}
    loaded = Station({"station_toml": station, "files_base64": encoded})
    kinds = {item["shape"]["kind"] for _, item in loaded.objects.values()}
    assert kinds >= {"sphere", "cylinder", "box", "convex_parts", "mesh", "revolved", "compound"}
    for object_id, (_, item) in loaded.objects.items():
        size = object_mesh(loaded, object_id).extents
        assert np.all(size > 0.005) and np.all(size < 0.3), f"{object_id} measures {size} m"
        if item["shape"]["kind"] == "box":
            np.testing.assert_allclose(size, item["shape"]["size_m"], atol=1e-9)
    np.testing.assert_allclose(object_mesh(loaded, "wedge_80mm").extents, [0.08, 0.06, 0.04], atol=1e-6)
    loaded.objects["odd"] = ("", {"shape": {"kind": "spline"}})
    with pytest.raises(PalpateError, match="unknown shape 'spline'"):
        object_mesh(loaded, "odd")


def test_the_live_hand_is_shown_and_moves(p: Palpate, viewer: Viewer, tmp_path: Path) -> None:
    until("shown", lambda: viewer.scene is not None and "felt" in viewer.status.value)
    assert viewer.scene is not None
    tip = viewer.scene.taxels["index_tip"][0]
    before = np.array(tip.position)
    until("ready", lambda: all(device.link == "ready" for device in p.live().devices))
    with p.control("viewer test") as hand:
        arm_and_move(hand, {"index_mcp_forward": p.live().joints["index_mcp_forward"] + 0.4})
        until("moved", lambda: bool(np.linalg.norm(np.array(tip.position) - before) > 0.01))
    seen = picture(viewer, "felt", "live", tmp_path)
    # Robot, grid and background are of many colours; a page that draws nothing has one.
    assert len(np.unique(seen.reshape(-1, 3), axis=0)) > 200


def test_a_take_shows_felt_and_expected_taxels_and_the_object(p: Palpate, viewer: Viewer, tmp_path: Path) -> None:
    takes = p.session("small").takes
    most = {take.id: np.argmax(take.trace().active.sum(axis=1)) for take in takes}
    take = max(takes, key=lambda take: int(take.trace().active[most[take.id]].sum()))
    trace = take.trace()
    touched = trace.active[most[take.id]]
    viewer.show_take("small", take.id, model="nominal", time_s=float(trace.times_s[most[take.id]]))
    expected = take.replay("nominal").active[most[take.id]]
    assert f"{touched.sum()} felt, {expected.sum()} expected" in viewer.status.value
    assert viewer.scene is not None
    for patch in viewer.scene.station.patches:
        span = slice(patch.channels.start, patch.channels.stop)
        _, felt, above = viewer.scene.taxels[patch.id]
        assert ((felt.colors[:, 0] > 130) == touched[span]).all()
        assert above.visible == expected[span].any()
    seen = picture(viewer, "felt", "take", tmp_path)
    viewer.show_take("small", take.id, time_s=0.0)
    assert not trace.active[0].any()
    at_rest = picture(viewer, "0 felt", "take-at-rest", tmp_path)
    assert near(seen, FELT) > near(at_rest, FELT) + 20, "no felt taxel is orange"
    assert near(seen, EXPECTED) > near(at_rest, EXPECTED) + 20, "no expected taxel is blue"


def test_somebody_at_the_page_can_choose(viewer: Viewer) -> None:
    until("live", lambda: viewer.status.value.startswith("disarmed"))
    viewer.source.value = "small"
    viewer.choose(None)
    assert viewer.take.value == "take-01"
    viewer.take.value = "take-02"
    viewer.choose("take-02")
    viewer.time.value = 1.0
    viewer.plays.value = True
    until("played", lambda: bool(viewer.time.value > 1.5))
    viewer.plays.value = False
    viewer.source.value = "live"
    viewer.choose(None)
    until("live again", lambda: viewer.status.value.startswith("disarmed"))
