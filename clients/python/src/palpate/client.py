"""The client: what a studio has, as Python objects."""

from __future__ import annotations

import contextlib
import os
import shutil
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

import httpx

from palpate.connection import Connection
from palpate.documents import (
    CheckReport,
    DocSummary,
    FreeTake,
    Info,
    LiveDocument,
    ModelSummary,
    ObjectEntry,
    RecordingDocument,
    SessionDetail,
    SessionSummary,
    TakeSummary,
    TrashEntry,
    decode,
)
from palpate.errors import PalpateError
from palpate.jobs import Jobs
from palpate.runs import CalibrationRun, DiagnosisRun, Run
from palpate.station import Station
from palpate.traces import Frame, NewestFrame, Replay, Trace, frame_of, replay_of, trace_of

if TYPE_CHECKING:
    from palpate.control import Control

DEFAULT_URL = "http://127.0.0.1:8080"
REPLAY_TIMEOUT_S = 600.0
"""Replays with effects and uploads may take minutes."""


class Palpate:
    """A studio.

        with Palpate() as p:
            report = p.calibrate("demo").wait()
            print(report.held_out.calibrated.f1)

    `url` is by default what the environment variable PALPATE_URL says, else http://127.0.0.1:8080; `token` is what
    PALPATE_TOKEN says, if anything, and goes along with every request and WebSocket. `ca_file` holds certificates to
    trust besides the system's, such as a studio's own `tls/cert.pem`; by default what PALPATE_CA_FILE says. `jobs` are
    the studio's jobs of every kind.
    """

    def __init__(
        self,
        url: str | None = None,
        token: str | None = None,
        *,
        ca_file: str | Path | None = None,
        transport: httpx.BaseTransport | None = None,
    ) -> None:
        url = url or os.environ.get("PALPATE_URL") or DEFAULT_URL
        self.jobs = Jobs(self)
        self.connection = Connection(
            url,
            token or os.environ.get("PALPATE_TOKEN"),
            ca_file=ca_file or os.environ.get("PALPATE_CA_FILE"),
            transport=transport,
        )

    def __enter__(self) -> Palpate:
        try:
            found = self.info()
            if found.name != "palpate":
                raise PalpateError("No studio", f"{self.connection.url} is {found.name!r}, not a Palpate studio")
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<Palpate studio at {self.connection.url}>"

    def close(self) -> None:
        """Closes all connections."""
        self.connection.close()

    def info(self) -> Info:
        """Version, live station and where its data comes from."""
        return decode(Info, self.connection.json("GET", "/info"))

    def stations(self) -> list[str]:
        """Ids of the stations that the studio ships with."""
        return decode(list[str], self.connection.json("GET", "/stations"))

    def station(self) -> Station:
        """The live station."""
        return Station(self.connection.json("GET", "/station"))

    # The manual

    def docs(self) -> list[DocSummary]:
        """The documents of the manual, by name."""
        return decode(list[DocSummary], self.connection.json("GET", "/docs"))

    def doc(self, name: str) -> str:
        """A document as Markdown, e.g. `learning`."""
        return self.connection.request("GET", "/docs/{doc}", doc=name).text

    # Sessions

    def sessions(self) -> list[SessionSummary]:
        """All sessions."""
        return decode(list[SessionSummary], self.connection.json("GET", "/sessions"))

    def session(self, session: str) -> Session:
        """A session by its id."""
        return Session(self, decode(SessionDetail, self.connection.json("GET", "/sessions/{session}", session=session)))

    def upload(self, path: str | os.PathLike[str], name: str | None = None, *, station: str | None = None) -> Session:
        """Uploads a session folder, a folder of CSV recordings, or a zip of either, as session `name`.

        `name` is by default that of the folder or file. `station` is the id of the shipped station that CSV recordings
        belong to; without it, the one that has their streams.
        """
        path = Path(path)
        with contextlib.ExitStack() as stack:
            archive = path
            if path.is_dir():
                folder = stack.enter_context(tempfile.TemporaryDirectory())
                archive = Path(shutil.make_archive(str(Path(folder) / "session"), "zip", path))
            try:
                content = stack.enter_context(archive.open("rb"))
            except OSError as error:
                raise PalpateError("Nothing to upload", f"failed to read {str(path)!r}: {error.strerror}") from error
            detail = self.connection.json(
                "POST",
                "/sessions",
                params={"name": name or (path.resolve().name if path.is_dir() else path.stem), "station": station},
                content=content,
                content_type="application/zip",
                timeout_s=REPLAY_TIMEOUT_S,
            )
        return Session(self, decode(SessionDetail, detail))

    def trash(self) -> list[TrashEntry]:
        """Deleted sessions and models, the one that was deleted last first.

        `restore_session` and `restore_model` take them out again.
        """
        return decode(list[TrashEntry], self.connection.json("GET", "/trash"))

    def restore_session(self, session: str) -> Session:
        """Takes a session out of the trash again."""
        detail = self.connection.json("POST", "/sessions/{session}/restore", session=session)
        return Session(self, decode(SessionDetail, detail))

    # Models and objects

    def models(self) -> list[Model]:
        """All saved sensor models."""
        return [Model(self, summary) for summary in decode(list[ModelSummary], self.connection.json("GET", "/models"))]

    def model(self, model: str) -> Model:
        """A saved sensor model by its id."""
        for found in self.models():
            if found.id == model:
                return found
        raise PalpateError("Not Found", f"no model {model!r}; models() lists them", 404)

    def restore_model(self, model: str) -> Model:
        """Takes a model out of the trash again."""
        return Model(self, decode(ModelSummary, self.connection.json("POST", "/models/{model}/restore", model=model)))

    def objects(self) -> list[ObjectEntry]:
        """All objects that can be touched or grasped."""
        return decode(list[ObjectEntry], self.connection.json("GET", "/objects"))

    # Calibrations and diagnoses

    def calibrate(
        self,
        session: str,
        *,
        method: str | None = None,
        hold_out: list[str] | None = None,
        shared_theta: bool = False,
    ) -> CalibrationRun:
        """Starts a calibration.

        `method` is `exact` (default) or `grid`; `hold_out` names takes that the fit never sees;
        `shared_theta` fits one theta to all streams of a kind, which else have one each.
        """
        body: dict[str, Any] = {"session": session, "method": method, "hold_out": hold_out}
        if shared_theta:
            body["shared_theta"] = True
        return CalibrationRun(self, self.connection.json("POST", "/calibrations", body=body))

    def calibrations(self) -> list[CalibrationRun]:
        """All calibrations, newest first; `refresh` one to get its report."""
        return [CalibrationRun(self, document) for document in self.connection.json("GET", "/calibrations")]

    def calibration(self, run: str) -> CalibrationRun:
        """A calibration by its id."""
        return CalibrationRun(self, self.connection.json("GET", "/calibrations/{run}", run=run))

    def diagnose(
        self,
        session: str,
        *,
        model: str | None = None,
        hold_out: list[str] | None = None,
        max_effects: int | None = None,
        without: list[str] | None = None,
        null_sessions: int | None = None,
        references: list[str] | None = None,
    ) -> DiagnosisRun:
        """Starts a diagnosis, which names the effects that the calibrated model lacks.

        Args:
            session: Id of the session.
            model: Id of a saved model to start from; None means that one is calibrated first.
            hold_out: Takes that only the report looks at; None means chosen automatically.
            max_effects: Most effects to name.
            without: Effects to leave out of the library, by id.
            null_sessions: Sessions to simulate first to set the station's bar anew.
            references: Ids of at least three sessions of the station in which nothing is wrong; what they leave sets
                the limits.

        """
        body = {
            "session": session,
            "model": model,
            "hold_out": hold_out,
            "max_effects": max_effects,
            "without": without or [],
            "null_sessions": null_sessions,
            "references": references or [],
        }
        return DiagnosisRun(self, self.connection.json("POST", "/diagnoses", body=body))

    def diagnoses(self) -> list[DiagnosisRun]:
        """All diagnoses, newest first; `refresh` one to get its report."""
        return [DiagnosisRun(self, document) for document in self.connection.json("GET", "/diagnoses")]

    def diagnosis(self, run: str) -> DiagnosisRun:
        """A diagnosis by its id."""
        return DiagnosisRun(self, self.connection.json("GET", "/diagnoses/{run}", run=run))

    # The live station

    def live(self) -> LiveDocument:
        """The newest state of the live station."""
        return decode(LiveDocument, self.connection.json("GET", "/live"))

    def stream(self) -> Iterator[Frame]:
        """Live frames, 30 a second at most; a loop that is slower gets the newest ones. Break off to end it."""
        station = self.station()
        with self.connection.socket("GET", "/stream", max_queue=16) as socket:
            newest = NewestFrame(socket)
            while (found := newest.wait()) is not None:
                message, skipped = found
                yield frame_of(message, station, skipped)

    def set_live_model(self, model: str) -> None:
        """Chooses what the simulator beside the hardware simulates with: the id of a saved model, or `nominal`."""
        self.connection.json("PUT", "/live/model", body={"model": model})

    def audit(self) -> list[dict[str, Any]]:
        """Who moved or stopped the station lately, oldest first."""
        import json

        return [json.loads(line) for line in self.connection.request("GET", "/audit").text.splitlines() if line.strip()]

    def control(self, name: str, *, take_over: bool = False) -> Control:
        """Control of the live station, to be taken by `with`: an operator like those at the page.

        with p.control("my script") as hand:
            hand.arm()
            hand.move({"index_pip": 0.6})
        """
        from palpate.control import Control

        return Control(self, name, take_over=take_over)

    def stop(self) -> None:
        """STOP, which anybody may: torque goes off. Returns when readings confirm that, else raises."""
        from palpate.control import stop

        stop(self.connection)

    # Recording; what decides anything needs control, which this client has inside `with p.control(...)`.

    def recording(self) -> RecordingDocument:
        """Plans, and the session under way."""
        return decode(RecordingDocument, self.connection.json("GET", "/recording"))

    def start_recording(
        self, plan: str, session: str, *, operator: str = "", only_wanted: bool = False
    ) -> RecordingDocument:
        """Begins a session by a plan of the station, or goes on with one that was begun. Needs control."""
        body = {"plan": plan, "session": session, "operator": operator, "only_wanted": only_wanted}
        return decode(RecordingDocument, self.connection.json("POST", "/recording", body=body, as_operator=True))

    def act(self, action: str, **arguments: object) -> RecordingDocument:
        """Does a step of the session under way. Needs control.

        `action`: `confirm_object` (with `fixture_trusted=`), `go_to_start`, `run`, `cancel`, `accept`, `again`,
        `discard`, `undo`, `select` (with `step=`), `note` (with `text=`) or `leave`.
        """
        body = {"action": action, **arguments}
        return decode(RecordingDocument, self.connection.json("POST", "/recording/act", body=body, as_operator=True))

    def begin_take(
        self,
        session: str,
        object: str,
        object_pose: Sequence[float],
        *,
        primitive: str = "free",
        fixture_trusted: bool = False,
        operator: str = "",
        surroundings: Sequence[Mapping[str, Any]] = (),
        marks_baseline: bool = False,
    ) -> RecordingDocument:
        """Begins a take outside guided sessions, in `session`, which is made if there is none. Needs control.

        `object_pose`: x, y, z in m from the robot's base, then the quaternion, w first. `surroundings`: fixed boxes,
        each with `pose` (seven numbers too) and `size_m`. The span without touch is marked until a joint of the hand is
        told to move; with `marks_baseline` it is marked by `act_on_take`. The take ends with `end_take`, with control,
        and when the station stops following.
        """
        body = {
            "session": session,
            "object": object,
            "object_pose": list(object_pose),
            "primitive": primitive,
            "fixture_trusted": fixture_trusted,
            "operator": operator,
            "surroundings": [dict(box) for box in surroundings],
            "marks_baseline": marks_baseline,
        }
        return decode(RecordingDocument, self.connection.json("POST", "/recording/take", body=body, as_operator=True))

    def act_on_take(self, action: str, **arguments: object) -> RecordingDocument:
        """Does something with the take outside guided sessions. Needs control.

        `action`: `begin_mark` or `end_mark` (with `kind=` `baseline`, `repetition` or `note`, and `label=`), or `end`
        (with `set_aside=`).
        """
        body = {"action": action, **arguments}
        return decode(
            RecordingDocument, self.connection.json("POST", "/recording/take/act", body=body, as_operator=True)
        )

    def end_take(self, *, set_aside: bool = False, timeout_s: float = 30.0) -> FreeTake:
        """Ends the take and returns what became of it, once the studio has checked it. Needs control."""
        document = self.act_on_take("end", set_aside=set_aside)
        deadline = time.monotonic() + timeout_s
        while document.free is None or document.free.state in ("recording", "checking"):
            if time.monotonic() > deadline:
                raise PalpateError("Timeout", f"the studio did not check the take in {timeout_s:g} s")
            time.sleep(0.05)
            document = self.recording()
        return document.free

    def want(self, object: str, primitive: str, because: str = "") -> RecordingDocument:
        """Adds a take to the checklist."""
        body = {"object": object, "primitive": primitive, "because": because}
        return decode(RecordingDocument, self.connection.json("POST", "/recording/wanted", body=body, as_operator=True))

    def unwant(self, object: str, primitive: str) -> RecordingDocument:
        """Takes it off the checklist again."""
        document = self.connection.json(
            "DELETE",
            "/recording/wanted/{object}/{primitive}",
            as_operator=True,
            object=object,
            primitive=primitive,
        )
        return decode(RecordingDocument, document)

    # Emulated stations

    def place_object(self, object: str | None) -> None:
        """Puts an object where the plan of an emulated station has it; None takes it away."""
        self.connection.json("POST", "/emulator/object", body={"object": object}, as_operator=True)

    def faults(self) -> str:
        """What is wrong with emulated devices, TOML."""
        return self.connection.request("GET", "/emulator/faults").text

    def set_faults(self, toml: str) -> str:
        """Says what is wrong with emulated devices from now on; nothing if the text is empty."""
        return self.connection.request("PUT", "/emulator/faults", content=toml, as_operator=True).text


class Session:
    """A recorded session. `takes` are in the order in which they were recorded."""

    def __init__(self, palpate: Palpate, detail: SessionDetail) -> None:
        self._palpate = palpate
        self._station: Station | None = None
        self.id = detail.summary.id
        self.summary: SessionSummary = detail.summary
        self.takes = [Take(self, palpate, summary) for summary in detail.takes]

    def __repr__(self) -> str:
        return f"<session {self.id}: {len(self.takes)} takes on {self.summary.station}>"

    def take(self, take: str) -> Take:
        """A take by its id, e.g. `take-03`."""
        for found in self.takes:
            if found.id == take:
                return found
        raise PalpateError(
            "Not Found", f"session {self.id!r} has no take {take!r}; it has {[t.id for t in self.takes]}", 404
        )

    def station(self) -> Station:
        """The station that recorded it."""
        if self._station is None:
            self._station = Station(
                self._palpate.connection.json("GET", "/sessions/{session}/station", session=self.id)
            )
        return self._station

    def check(self) -> CheckReport:
        """Rates, gaps, clocks and coverage."""
        return decode(CheckReport, self._palpate.connection.json("GET", "/sessions/{session}/check", session=self.id))

    def download(self, to: str | os.PathLike[str] = ".") -> Path:
        """Writes the session as a zip archive to a file or into a folder; `upload` takes it in again, at any studio."""
        return self._palpate.connection.download("GET", "/sessions/{session}/session.zip", to, session=self.id)

    def delete(self) -> None:
        """Moves the session to the trash; `restore_session` of the client takes it out again."""
        self._palpate.connection.request("DELETE", "/sessions/{session}", session=self.id)


class Take:
    """A take of a session."""

    def __init__(self, session: Session, palpate: Palpate, summary: TakeSummary) -> None:
        self._palpate = palpate
        self._trace: Trace | None = None
        self.session = session
        self.id = summary.id
        self.summary: TakeSummary = summary

    def __repr__(self) -> str:
        return f"<{self.id} of {self.session.id}: {self.summary.primitive} on {self.summary.object}>"

    def download(self, to: str | os.PathLike[str] = ".") -> Path:
        """Writes the MCAP file of the take to a file or into a folder."""
        return self._palpate.connection.download(
            "GET", "/sessions/{session}/takes/{take}/take.mcap", to, session=self.session.id, take=self.id
        )

    def trace(self) -> Trace:
        """What was recorded, as arrays. Takes never change, so that it is fetched once."""
        if self._trace is None:
            answer = self._palpate.connection.request(
                "GET", "/sessions/{session}/takes/{take}/trace", session=self.session.id, take=self.id
            )
            self._trace = trace_of(answer.content, self.session.station())
        return self._trace

    def replay(self, model: str | Model | Run[Any] = "nominal") -> Replay:
        """The take as a sensor model feels it.

        `model` is `nominal`, a model or its id, or a calibration or diagnosis, whose model need not be saved.
        """
        if isinstance(model, Model):
            model = model.id
        elif isinstance(model, CalibrationRun):
            model = f"run:{model.id}"
        elif isinstance(model, Run):
            model = f"diagnosis:{model.id}"
        answer = self._palpate.connection.request(
            "GET",
            "/sessions/{session}/takes/{take}/replay",
            params={"model": model},
            timeout_s=REPLAY_TIMEOUT_S,
            session=self.session.id,
            take=self.id,
        )
        return replay_of(answer.content, self.session.station(), self.trace().times_s)


class Model:
    """A saved sensor model."""

    def __init__(self, palpate: Palpate, summary: ModelSummary) -> None:
        self._palpate = palpate
        self.id = summary.id
        self.summary: ModelSummary = summary

    def __repr__(self) -> str:
        return f"<model {self.id}: {self.summary.name!r}, {len(self.summary.effects)} effects>"

    def toml(self) -> str:
        """Its file."""
        return self._palpate.connection.request("GET", "/models/{model}", model=self.id).text

    def undo(self) -> Model:
        """Brings the version before the last addition back."""
        summary = decode(ModelSummary, self._palpate.connection.json("POST", "/models/{model}/undo", model=self.id))
        return Model(self._palpate, summary)

    def delete(self) -> None:
        """Moves the model to the trash; `restore_model` of the client takes it out again."""
        self._palpate.connection.request("DELETE", "/models/{model}", model=self.id)
