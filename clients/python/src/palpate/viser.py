"""The hand in viser: its joints move, its taxels take the colour of their readings, live and from takes.

    from palpate import Palpate
    from palpate.viser import show

    with Palpate() as p:
        viewer = show(p)                                   # the live station; in a notebook, below the cell
        viewer.show_take("demo", "take-03", model="nominal", time_s=4.0)

Felt taxels are orange, the stronger the reading the brighter. What a model expects floats as blue dots above the skin:
orange under blue is agreement, orange alone was felt but not expected, blue alone expected but not felt.
"""

from __future__ import annotations

import argparse
import copy
import io
import itertools
import posixpath
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path, PurePosixPath
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from palpate.client import Palpate, Take
from palpate.errors import PalpateError
from palpate.station import Pose, Station
from palpate.traces import Bools, Singles

try:
    import trimesh
    import viser
    import yourdfpy
    from viser.extras import ViserUrdf
except ImportError as error:
    raise PalpateError("No viser", "the viewer needs viser and yourdfpy: pip install 'palpate[viser]'") from error

LIVE = "live"
NO_MODEL = "none"
FRAMES_PER_S = 15.0
"""More pictures a second cost a core and show no more."""
QUIET = (70, 72, 84)
FELT = (255, 120, 0)
EXPECTED = (40, 120, 255)
OBJECT = (120, 150, 140)
TAXEL_M = 0.006
OFF_SKIN_M = 0.0012
"""Felt taxels are drawn so far above the skin that the hand's shapes do not hide them."""
EXPECTED_OFF_SKIN_M = 0.008
FULL_COLOUR = 4.0
"""A reading of so many times the threshold of its stream has the full colour."""


def plain_urdf(text: bytes) -> bytes:
    """Robot file without `<capsule>`, which URDF does not know: a cylinder and two balls in the place of each."""
    root = ElementTree.fromstring(text)
    for link in root.iter("link"):
        for part in [part for part in link if part.find("geometry/capsule") is not None]:
            geometry = part.find("geometry")
            capsule = part.find("geometry/capsule")
            assert geometry is not None and capsule is not None
            radius, length = capsule.get("radius", "0"), float(capsule.get("length", "0"))
            geometry.remove(capsule)
            origin = part.find("origin")
            place = {} if origin is None else origin.attrib
            xyz = np.array([float(number) for number in place.get("xyz", "0 0 0").split()])
            rpy = [float(number) for number in place.get("rpy", "0 0 0").split()]
            half = Pose.read({"rpy_rad": rpy}).matrix()[:3, 2] * length / 2
            for end_at in (xyz + half, xyz - half):
                end = copy.deepcopy(part)
                at = end.find("origin")
                at = ElementTree.SubElement(end, "origin") if at is None else at
                at.set("xyz", " ".join(map(str, end_at)))
                ball = end.find("geometry")
                assert ball is not None
                ElementTree.SubElement(ball, "sphere", radius=radius)
                link.append(end)
            ElementTree.SubElement(geometry, "cylinder", radius=radius, length=str(length))
    return ElementTree.tostring(root)


def object_mesh(station: Station, object_id: str) -> trimesh.Trimesh:
    """The shape of an object of the station as one mesh, in the object's frame."""
    return _mesh(station, object_id, station.objects[object_id][1]["shape"])


def _mesh(station: Station, object_id: str, shape: dict[str, Any]) -> trimesh.Trimesh:
    kind = shape["kind"]
    if kind == "sphere":
        return trimesh.creation.icosphere(subdivisions=4, radius=shape["radius_m"])
    if kind == "cylinder":
        return trimesh.creation.cylinder(radius=shape["radius_m"], height=shape["height_m"])
    if kind == "capsule":
        length = shape["length_m"]
        mesh = trimesh.creation.capsule(radius=shape["radius_m"], height=length)
        return mesh.apply_translation(-mesh.bounds.mean(axis=0))
    if kind == "box":
        return trimesh.creation.box(extents=shape["size_m"])
    if kind == "convex_parts":
        return trimesh.util.concatenate([trimesh.convex.convex_hull(np.array(points)) for points in shape["parts_m"]])
    if kind == "mesh":
        data = io.BytesIO(station.object_mesh(object_id, shape["file"]))
        mesh = trimesh.load(data, file_type=PurePosixPath(shape["file"]).suffix[1:].lower(), force="mesh")
        return mesh.apply_scale(shape.get("scale", 1.0))
    if kind == "revolved":
        profile = np.asarray(shape["profile_m"], float)
        sweep, segments = shape.get("sweep_rad", 2 * np.pi), int(shape["segments"])
        angles = np.linspace(0.0, sweep, segments + 1)
        rings = [np.column_stack([profile[:, 0] * np.cos(a), profile[:, 0] * np.sin(a), profile[:, 1]]) for a in angles]
        hulls = [trimesh.convex.convex_hull(np.concatenate(pair)) for pair in itertools.pairwise(rings)]
        return trimesh.util.concatenate(hulls)
    if kind == "compound":
        parts = []
        for part in shape["parts"]:
            pose = Pose.read(part.get("pose", {})).matrix()
            parts.append(_mesh(station, object_id, part["shape"]).apply_transform(pose))
        return trimesh.util.concatenate(parts)
    raise PalpateError("Newer station", f"object {object_id!r} has the unknown shape {kind!r}")


class Scene:
    """A station in a viser server: robot, taxels, expected touch, object."""

    def __init__(self, server: viser.ViserServer, station: Station) -> None:
        self.server = server
        self.station = station
        robot = station.robot_file
        with tempfile.TemporaryDirectory() as folder:

            def mesh_file(name: str) -> str:
                path = posixpath.join(posixpath.dirname(robot), name.split("://")[-1])
                data = station.files.get(path) or station.file(posixpath.normpath(path))
                place = Path(folder) / PurePosixPath(name).name
                place.write_bytes(data)
                return str(place)

            text = io.BytesIO(plain_urdf(station.file(robot)))
            self.urdf = yourdfpy.URDF.load(text, build_scene_graph=True, filename_handler=mesh_file)
            server.scene.reset()
            self.robot = ViserUrdf(server, self.urdf, root_node_name="/robot")
        order = {joint: dof for dof, joint in enumerate(station.joints)}
        self._order = [order.get(joint) for joint in self.urdf.actuated_joint_names]
        server.scene.add_grid("/grid", width=2.0, height=2.0)
        self._threshold = np.zeros(len(station.channels))
        for stream in station.streams.values():
            self._threshold[stream.channels.start : stream.channels.stop] = stream.on_threshold
        self.taxels: dict[str, tuple[viser.FrameHandle, viser.PointCloudHandle, viser.PointCloudHandle]] = {}
        for patch in station.patches:
            name = f"/taxels/{patch.id}"
            frame = server.scene.add_frame(name, show_axes=False)
            points = (patch.points_m + OFF_SKIN_M * patch.normals).astype(np.float32)
            above = (patch.points_m + EXPECTED_OFF_SKIN_M * patch.normals).astype(np.float32)
            felt = self._dots(f"{name}/felt", points, QUIET, TAXEL_M)
            expected = self._dots(f"{name}/expected", above, EXPECTED, 0.5 * TAXEL_M)
            expected.visible = False
            self.taxels[patch.id] = (frame, felt, expected)
        self._object: tuple[str, viser.MeshHandle] | None = None
        self.pose(np.zeros(len(station.joints), np.float32))

    def _dots(self, name: str, points: Singles, colour: tuple[int, int, int], size: float) -> viser.PointCloudHandle:
        return self.server.scene.add_point_cloud(
            name, points, colour, point_size=size, point_shape="circle", point_shading="flat", precision="float32"
        )

    def pose(self, joint_positions: Singles) -> None:
        """Moves the robot, and with it the taxels."""
        self.robot.update_cfg(np.array([0.0 if dof is None else joint_positions[dof] for dof in self._order]))
        for patch in self.station.patches:
            frame = self.taxels[patch.id][0]
            matrix = self.urdf.get_transform(patch.link)
            frame.position, frame.wxyz = matrix[:3, 3], trimesh.transformations.quaternion_from_matrix(matrix)

    def look_at_taxels(self, felt: Bools) -> None:
        """Lets pages that open from now on begin with a view of the taxels, from where the felt ones face."""
        places, ways = [], []
        for patch in self.station.patches:
            matrix = self.urdf.get_transform(patch.link)
            places.append(patch.points_m @ matrix[:3, :3].T + matrix[:3, 3])
            ways.append(patch.normals @ matrix[:3, :3].T)
        points, normals = np.concatenate(places), np.concatenate(ways)
        reach = np.linalg.norm(points - points.mean(axis=0), axis=1).max()
        up = np.array([0.0, 0.0, 1.0])
        if felt.any():
            # Straight at them, through the object that they touch.
            centre, way, distance = points[felt].mean(axis=0), normals[felt].mean(axis=0) + 0.2 * up, 1.4 * reach
        else:
            facing = normals.mean(axis=0)
            centre, way, distance = points.mean(axis=0), facing + 0.35 * up + 0.5 * np.cross(up, facing), 2.0 * reach
        self.server.initial_camera.look_at = tuple(centre)
        self.server.initial_camera.position = tuple(centre + distance * way / max(float(np.linalg.norm(way)), 1e-6))

    def touch(self, active: Bools, raw: Singles | None, expected: Bools | None) -> None:
        """Colours taxels by their readings, or by activation without readings, and shows what a model expects."""
        level = active.astype(float) if raw is None else np.clip(raw / (FULL_COLOUR * self._threshold), 0.0, 1.0)
        # What counts as touch is told from what does not.
        level = np.where(active, np.maximum(level, 0.35), 0.5 * level)[:, None]
        colours: NDArray[np.uint8] = ((1 - level) * np.array(QUIET) + level * np.array(FELT)).astype(np.uint8)
        for patch in self.station.patches:
            _, felt, above = self.taxels[patch.id]
            span = slice(patch.channels.start, patch.channels.stop)
            felt.colors = colours[span]
            shown = np.zeros(len(patch.channels), bool) if expected is None else expected[span]
            if shown.any():
                points = patch.points_m + EXPECTED_OFF_SKIN_M * patch.normals
                above.points = points[shown].astype(np.float32)
                above.colors = np.tile(np.array(EXPECTED, np.uint8), (int(shown.sum()), 1))
            above.visible = bool(shown.any())

    def place(self, object_id: str, pose: list[float]) -> None:
        """Puts an object at x, y, z, w, x, y, z; none where the id is empty or no object of the station."""
        if self._object is not None and self._object[0] != object_id:
            self._object[1].remove()
            self._object = None
        if object_id not in self.station.objects or len(pose) != 7:
            return
        if self._object is None:
            mesh = object_mesh(self.station, object_id)
            # Taxels that it touches shine through.
            shown = self.server.scene.add_mesh_simple(
                "/object", mesh.vertices, mesh.faces, color=OBJECT, opacity=0.35, flat_shading=True
            )
            self._object = (object_id, shown)
        handle = self._object[1]
        handle.position, handle.wxyz = np.array(pose[:3]), np.array(pose[3:])


class Viewer:
    """A page that shows a studio's live station or one of its takes. `url` is its address."""

    def __init__(self, palpate: Palpate, *, host: str = "127.0.0.1", port: int = 8090) -> None:
        self._palpate = palpate
        self._lock = threading.RLock()
        self._shows = 0
        self.scene: Scene | None = None
        self._take: Take | None = None
        self.server = viser.ViserServer(host=host, port=port, label="Palpate", verbose=False)
        self.url = f"http://{host}:{self.server.get_port()}"
        gui = self.server.gui
        sessions = [session.id for session in palpate.sessions() if session.error is None]
        models = [NO_MODEL, "nominal", *(model.id for model in palpate.models())]
        # mypy does not see that the values of these can be set.
        self.source: Any = gui.add_dropdown("Show", [LIVE, *sessions])
        self.take: Any = gui.add_dropdown("Take", ["-"], visible=False)
        self.model: Any = gui.add_dropdown("Model", models, visible=False)
        self.time: Any = gui.add_slider("Time, s", min=0.0, max=1.0, step=0.1, initial_value=0.0, visible=False)
        self.plays: Any = gui.add_checkbox("Play", False, visible=False)
        self.status: Any = gui.add_text("State", "", disabled=True)
        gui.add_markdown("**Orange**: felt, brighter with the reading. **Blue, above the skin**: expected.")
        self.source.on_update(self._by_person(lambda: self.choose(None)))
        self.take.on_update(self._by_person(lambda: self.choose(self.take.value)))
        self.model.on_update(self._by_person(lambda: self.choose(self.take.value)))
        self.time.on_update(self._by_person(self._draw))
        threading.Thread(target=self._play, name="palpate-play", daemon=True).start()

    def close(self) -> None:
        """Ends the page."""
        with self._lock:
            self._shows = -1
        self.server.stop()

    def show_live(self) -> None:
        """Shows the live station from now on."""
        with self._lock:
            self._shows += 1
            self._take = None
            self.source.value = LIVE
            for handle in (self.take, self.model, self.time, self.plays):
                handle.visible = False
            threading.Thread(target=self._follow, args=(self._shows,), name="palpate-live", daemon=True).start()

    def show_take(
        self, session: str, take: str | None = None, *, model: str | None = None, time_s: float = 0.0
    ) -> None:
        """Shows a take, by default the first, and what a model expects there: `nominal`, or the id of a saved one."""
        found = self._palpate.session(session)
        chosen = found.take(take) if take else found.takes[0]
        trace = chosen.trace()
        self._raw = trace.raw_at_frames()
        self._replay = chosen.replay(model) if model and model != NO_MODEL else None
        with self._lock:
            self._shows += 1
            scene = self._enter(found.station())
            self._take = chosen
            self.source.value = session
            self.take.options = [item.id for item in found.takes]
            self.take.value = chosen.id
            self.model.value = model or NO_MODEL
            self.time.max = max(float(np.floor(trace.times_s[-1] * 10) / 10), 0.1)
            self.time.value = min(max(time_s, 0.0), self.time.max)
            for handle in (self.take, self.model, self.time, self.plays):
                handle.visible = True
            self._draw()
            scene.look_at_taxels(trace.active[self._frame()])

    @staticmethod
    def _by_person(react: Callable[[], None]) -> Callable[[Any], None]:
        """Reacts to what somebody at the page changed, and not to what this program did."""

        def changed(event: Any) -> None:  # noqa: ANN401
            if event.client is not None:
                react()

        return changed

    def choose(self, take: str | None) -> None:
        """Does what the page's controls say."""
        try:
            if self.source.value == LIVE:
                self.show_live()
            else:
                self.show_take(self.source.value, take, model=self.model.value, time_s=self.time.value if take else 0.0)
        except PalpateError as error:
            self.status.value = str(error)

    def _enter(self, station: Station) -> Scene:
        if self.scene is None or self.scene.station.files != station.files:
            self.scene = Scene(self.server, station)
        return self.scene

    def _follow(self, shows: int) -> None:
        """Draws live frames for as long as nothing else is shown."""
        while self._shows == shows:
            try:
                with self._lock:
                    scene = self._enter(self._palpate.station())
                drawn, is_aimed = 0.0, False
                for frame in self._palpate.stream():
                    # Frames that come a little early would halve the rate.
                    if time.monotonic() - drawn < 0.8 / FRAMES_PER_S:
                        continue
                    drawn = time.monotonic()
                    with self._lock:
                        if self._shows != shows:
                            return
                        with self.server.atomic():
                            scene.pose(np.nan_to_num(frame.joint_positions))
                            scene.touch(frame.active, frame.raw, frame.expected)
                            scene.place(frame.message.object, list(frame.message.object_pose))
                        if not is_aimed:
                            scene.look_at_taxels(frame.active)
                            is_aimed = True
                        self.status.value = f"{frame.phase}: {len(frame.felt())} felt"
            except PalpateError as error:
                self.status.value = str(error)
            time.sleep(1.0)

    def _frame(self) -> int:
        """Index of the take's joint frame that is nearest to where the slider stands."""
        return 0 if self._take is None else int(np.argmin(np.abs(self._take.trace().times_s - self.time.value)))

    def _draw(self) -> None:
        """Draws the moment of the take that the slider stands at."""
        with self._lock:
            if self._take is None or self.scene is None:
                return
            trace, pose = self._take.trace(), self._take.summary.object_pose
            frame = self._frame()
            if trace.object_poses is not None:
                pose = trace.object_poses[frame].tolist()
            expected = None if self._replay is None else self._replay.active[frame]
            with self.server.atomic():
                self.scene.pose(trace.joint_positions[frame])
                self.scene.touch(trace.active[frame], None if self._raw is None else self._raw[frame], expected)
                self.scene.place(self._take.summary.object, pose)
            text = f"{self._take.summary.primitive}: {trace.active[frame].sum()} felt"
            if expected is not None:
                text += f", {expected.sum()} expected, {(expected & trace.active[frame]).sum()} both"
            self.status.value = text

    def _play(self) -> None:
        while self._shows >= 0:
            begun = time.monotonic()
            time.sleep(1 / FRAMES_PER_S)
            with self._lock:
                if self._take is not None and self.plays.value:
                    later = self.time.value + time.monotonic() - begun
                    self.time.value = later if later < self.time.max else 0.0
                    self._draw()


def show(palpate: Palpate, *, host: str = "127.0.0.1", port: int = 8090) -> Viewer:
    """Opens a viewer of the studio's live station, or of its first session where none is live.

    In a notebook the page appears below the cell; elsewhere open the viewer's `url`.
    """
    viewer = Viewer(palpate, host=host, port=port)
    if palpate.info().station is not None:
        viewer.show_live()
    elif len(viewer.source.options) > 1:
        viewer.show_take(viewer.source.options[1])
    if "ipykernel" in sys.modules:
        viewer.server.scene.show()
    return viewer


def main() -> None:
    """Runs `palpate-viser`."""
    parser = argparse.ArgumentParser(prog="palpate-viser", description="Show a Palpate studio's hand in viser")
    parser.add_argument("--url", help="address of the studio [default: PALPATE_URL, else http://127.0.0.1:8080]")
    parser.add_argument("--token", help="token of the studio [default: PALPATE_TOKEN]")
    parser.add_argument("--ca-file", help="certificates to trust, e.g. the studio's own [default: PALPATE_CA_FILE]")
    parser.add_argument("--host", default="127.0.0.1", help="address of the viewer's page [default: 127.0.0.1]")
    parser.add_argument("--port", type=int, default=8090, help="port of the viewer's page [default: 8090]")
    parser.add_argument("--session", help="show this session instead of the live station")
    parser.add_argument("--take", help="which of its takes, e.g. take-03 [default: the first]")
    parser.add_argument("--model", help="show what this model expects: nominal, or the id of a saved one")
    parser.add_argument("--at", type=float, default=0.0, metavar="SECONDS", help="where in the take to begin")
    args = parser.parse_args()
    try:
        with Palpate(args.url, args.token, ca_file=args.ca_file) as palpate:
            viewer = show(palpate, host=args.host, port=args.port)
            if args.session:
                viewer.show_take(args.session, args.take, model=args.model, time_s=args.at)
            print(f"the viewer is at {viewer.url}; Ctrl-C ends it", flush=True)
            viewer.server.sleep_forever()
    except KeyboardInterrupt:
        pass
    except PalpateError as error:
        sys.exit(f"palpate-viser: {error}")


if __name__ == "__main__":
    main()
