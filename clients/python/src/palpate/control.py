"""Control of the live station: a lease, heartbeats, and commands that pass the station's safety layer."""

from __future__ import annotations

import concurrent.futures
import contextlib
import math
import threading
import time
from collections.abc import Mapping, Sequence
from types import TracebackType
from typing import TYPE_CHECKING, Any

import websockets.exceptions
from google.protobuf.message import DecodeError, Message
from websockets.sync.client import ClientConnection

from palpate.connection import Connection
from palpate.control_pb2 import (
    Acquire,
    Arm,
    ClearFault,
    ControlReply,
    ControlRequest,
    Disarm,
    Heartbeat,
    LeadThrough,
    ObjectPose,
    Release,
    ResetStop,
    Stop,
    Tare,
    Targets,
)
from palpate.errors import PalpateError

if TYPE_CHECKING:
    from palpate.client import Palpate
    from palpate.documents import LiveDocument

HEARTBEAT_S = 0.05
"""The station wants 20 heartbeats a second, and brakes without one for 0.15 s."""
REPLY_S = 10.0
"""A request that is not answered for so long failed, s. A STOP takes 1 s at most to be confirmed."""
POLL_S = 0.05
SETTLED_S = 0.5
"""The live document shows what a command did after so long at the latest, s."""

_FIELDS: dict[type[Message], str] = {
    Acquire: "acquire",
    Release: "release",
    Heartbeat: "heartbeat",
    Arm: "arm",
    Disarm: "disarm",
    Stop: "stop",
    ResetStop: "reset_stop",
    Targets: "targets",
    LeadThrough: "lead_through",
    ClearFault: "clear_fault",
    Tare: "tare",
    ObjectPose: "object_pose",
}


class _Channel:
    """Requests of one control connection, and the replies to them."""

    def __init__(self, socket: ClientConnection) -> None:
        self.lease = 0
        self.ended = ""
        self._socket = socket
        self._sequence = 0
        self._waiting: dict[int, concurrent.futures.Future[ControlReply]] = {}
        self._lock = threading.Lock()
        threading.Thread(target=self._read, name="palpate-control-replies", daemon=True).start()

    def send(self, command: Message) -> concurrent.futures.Future[ControlReply]:
        """Sends a command under the lease that this connection holds."""
        reply: concurrent.futures.Future[ControlReply] = concurrent.futures.Future()
        # Numbers must arrive in their order, so that nothing comes between counting and sending.
        with self._lock:
            if self.ended:
                raise PalpateError("No control", self.ended)
            self._sequence += 1
            field: dict[str, Any] = {_FIELDS[type(command)]: command}
            request = ControlRequest(sequence=self._sequence, lease=self.lease, **field)
            self._waiting[self._sequence] = reply
            try:
                self._socket.send(request.SerializeToString())
            except websockets.exceptions.ConnectionClosed as error:
                raise PalpateError("No control", f"the connection to the station has ended: {error}") from error
        return reply

    def ask(self, command: Message) -> ControlReply:
        """Sends a command and waits for its reply, whatever it is."""
        try:
            return self.send(command).result(REPLY_S)
        except concurrent.futures.TimeoutError as error:
            raise PalpateError(
                "Timeout", f"the station did not answer {type(command).__name__} in {REPLY_S:g} s"
            ) from error

    def must(self, command: Message) -> ControlReply:
        """The same for what must be accepted."""
        reply = self.ask(command)
        if not reply.accepted:
            raise PalpateError(f"{type(command).__name__} refused", reply.problem)
        return reply

    def _read(self) -> None:
        why = "the studio ended the connection"
        try:
            for data in self._socket:
                reply = ControlReply.FromString(data if isinstance(data, bytes) else data.encode())
                with self._lock:
                    self.lease = reply.lease
                    waiting = self._waiting.pop(reply.sequence, None)
                if waiting is not None:
                    waiting.set_result(reply)
        except (websockets.exceptions.ConnectionClosed, DecodeError) as error:
            why = f"the connection to the station has ended: {error}"
        with self._lock:
            self.ended = why
            waiting_still, self._waiting = list(self._waiting.values()), {}
        for waiting in waiting_still:
            waiting.set_exception(PalpateError("No control", why))


def stop(connection: Connection) -> None:
    """STOP by a connection of its own, which needs no control."""
    with connection.socket("GET", "/control", max_queue=16) as socket:
        _stop(_Channel(socket))


def _stop(channel: _Channel) -> None:
    reply = channel.must(Stop())
    if not reply.stop_confirmed:
        raise PalpateError("Stop not confirmed", f"{reply.problem}; assume that the hand moves, and cut its power")


class Control:
    """Control of the live station, while its `with` block lasts.

    The station knows its operator by name, others watch, and every command passes its safety layer. Heartbeats go out
    from a thread; a program that ends, hangs in native code or loses its network stops sending them, and the station
    brakes within 0.15 s and is limp within 0.5 s. Leaving the block gives control back and disarms.
    """

    def __init__(self, palpate: Palpate, name: str, *, take_over: bool = False) -> None:
        self._palpate = palpate
        self._name = name
        self._take_over = take_over
        self._stack = contextlib.ExitStack()
        self._channel: _Channel | None = None
        self._leaves = threading.Event()
        self._lost = ""

    def __enter__(self) -> Control:
        station = self._palpate.station()
        self._joints = {joint: dof for dof, joint in enumerate(station.joints)}
        with contextlib.ExitStack() as stack:
            socket = stack.enter_context(self._palpate.connection.socket("GET", "/control", max_queue=64))
            self._channel = _Channel(socket)
            reply = self._channel.must(Acquire(operator=self._name, take_over=self._take_over))
            self._palpate.connection.lease = reply.lease
            self._stack = stack.pop_all()
        self._leaves.clear()
        self._lost = ""
        self._heart = threading.Thread(target=self._beat, name="palpate-heartbeats", daemon=True)
        self._heart.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._leaves.set()
        self._heart.join()
        try:
            # Control that was lost is nothing to give back.
            with contextlib.suppress(PalpateError):
                self._open().ask(Release())
        finally:
            self._palpate.connection.lease = 0
            self._channel = None
            self._stack.close()

    def _open(self) -> _Channel:
        if self._channel is None:
            raise PalpateError(
                "No control", "control is taken by `with p.control(name) as hand:` and ends with that block"
            )
        return self._channel

    def _must(self, command: Message) -> ControlReply:
        if self._lost:
            raise PalpateError("Control lost", self._lost)
        return self._open().must(command)

    def _beat(self) -> None:
        channel = self._open()
        due = time.monotonic()
        while not self._leaves.is_set():
            try:
                channel.send(Heartbeat()).add_done_callback(self._beaten)
            except PalpateError as error:
                self._lost = error.detail
            if self._lost:
                self._palpate.connection.lease = 0
                return
            due = max(due + HEARTBEAT_S, time.monotonic())
            self._leaves.wait(due - time.monotonic())

    def _beaten(self, done: concurrent.futures.Future[ControlReply]) -> None:
        if done.exception() is None and not done.result().accepted:
            self._lost = done.result().problem or "somebody else has taken control"

    # Commands

    def live(self) -> LiveDocument:
        """The newest state of the station."""
        return self._palpate.live()

    def arm(self, *, timeout_s: float = 10.0) -> None:
        """Torque on, where the joints are. Returns when the station follows commands."""
        self._must(Arm())
        self._until("armed", timeout_s)

    def disarm(self, *, timeout_s: float = 10.0) -> None:
        """Torque off in an orderly way: joints brake and come to rest first."""
        self._must(Disarm())
        self._until("disarmed", timeout_s)

    def targets(self, positions: Mapping[str, float]) -> None:
        """Says where joints shall go, rad or m, and returns at once; the safety layer limits speed and acceleration.

        Joints that are not named keep their last target. Targets beyond a joint's limits are refused, all of them.
        """
        unknown = [joint for joint in positions if joint not in self._joints]
        if unknown:
            raise PalpateError("No such joint", f"{unknown}; the station has {list(self._joints)}")
        wrong = {joint: value for joint, value in positions.items() if not math.isfinite(value)}
        if wrong:
            raise PalpateError("No position", f"{wrong}; positions are finite numbers, rad or m")
        dofs = [self._joints[joint] for joint in positions]
        self._must(Targets(dofs=dofs, positions=[float(value) for value in positions.values()]))

    def move(self, positions: Mapping[str, float], *, tolerance: float = 0.05, timeout_s: float = 20.0) -> LiveDocument:
        """Moves joints and returns once their readings are within `tolerance` (rad or m) of where they shall be."""
        deadline = time.monotonic() + timeout_s
        self.targets(positions)
        while True:
            state = self.live()
            if all(abs(state.joints[joint] - value) <= tolerance for joint, value in positions.items()):
                return state
            if self._lost or state.phase not in ("armed", "holding", "arming"):
                raise PalpateError(
                    "Not moved", self._lost or f"the station is {state.phase}: {state.reason or 'arm it first'}"
                )
            if time.monotonic() > deadline:
                off = {joint: state.joints[joint] for joint in positions}
                raise PalpateError("Timeout", f"after {timeout_s:g} s joints are at {off}, expected {dict(positions)}")
            if state.phase == "holding":
                # The station forgets targets when it holds.
                self.targets(positions)
            time.sleep(POLL_S)

    def stop(self) -> None:
        """STOP: torque goes off. Returns when readings confirm that, and raises where they do not."""
        channel = self._open()
        if channel.ended:
            stop(self._palpate.connection)
        else:
            _stop(channel)

    def reset_stop(self) -> None:
        """Ends a latched stop; the station stays disarmed."""
        self._must(ResetStop())

    def lead_through(self, on: bool) -> None:
        """Lets the arm yield to hands, or hold again."""
        self._must(LeadThrough(on=on))

    def clear_fault(self, device: str) -> None:
        """Clears what can be cleared of a device, by its id."""
        self._must(ClearFault(device=device))

    def tare(self) -> None:
        """Takes the mean reading of the next half second as that without touch."""
        self._must(Tare())

    def object_pose(self, pose: Sequence[float], *, time_s: float = 0.0) -> None:
        """Says where the object is, for the take that is recorded outside guided sessions.

        `pose`: x, y, z in m from the robot's base, then the quaternion, w first. `time_s`: when, in the station's time
        as live frames have it; 0 for now.
        """
        numbers = [float(value) for value in pose]
        self._must(ObjectPose(position_m=numbers[:3], quaternion_wxyz=numbers[3:], time_s=time_s))

    def _until(self, phase: str, timeout_s: float) -> None:
        """Waits until the station is in `phase`; raises if it stops or falls back instead."""
        begun = time.monotonic()
        while True:
            state = self.live()
            if state.phase == phase:
                return
            waited_s = time.monotonic() - begun
            # The document shows what was so a moment ago.
            has_failed = waited_s > SETTLED_S and state.phase in ("disarmed", "stopped")
            if has_failed or self._lost or waited_s > timeout_s:
                why = self._lost or state.reason or "it gives no reason"
                raise PalpateError(f"Not {phase}", f"the station is {state.phase} after {waited_s:.1f} s: {why}")
            time.sleep(POLL_S)
