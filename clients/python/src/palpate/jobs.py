"""Jobs of every kind: long work that the studio does, whatever becomes of this program."""

from __future__ import annotations

import builtins
import json
import time
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any, cast

import palpate.documents as documents
from palpate.documents import JobKindDocument, JobPage, decode
from palpate.errors import PalpateError
from palpate.runs import POLL_S, progress_bar

if TYPE_CHECKING:
    from palpate.client import Model, Palpate


class Job:
    """A job. `head` is where it stood when this client last asked."""

    def __init__(self, palpate: Palpate, head: documents.Job) -> None:
        self._palpate = palpate
        self.id = head.id
        self.head = head

    def __repr__(self) -> str:
        return f"<job {self.id}, {self.head.kind}: {self.head.state}, {self.head.fraction:.0%}>"

    @property
    def is_unfinished(self) -> bool:
        """Whether it waits or works."""
        return self.head.state in ("queued", "running")

    def _ask(self, method: str, path: str) -> Job:
        self.head = decode(documents.Job, self._palpate.connection.json(method, path, job=self.id))
        return self

    def refresh(self) -> Job:
        """Asks the studio where the job stands."""
        return self._ask("GET", "/jobs/{job}")

    def cancel(self) -> Job:
        """Asks the job to end."""
        return self._ask("POST", "/jobs/{job}/cancel")

    def retry(self) -> Job:
        """Begins a job that failed or was cancelled once more."""
        return self._ask("POST", "/jobs/{job}/retry")

    def delete(self) -> None:
        """Deletes a job that has ended, with its files."""
        self._palpate.connection.request("DELETE", "/jobs/{job}", job=self.id)

    def log(self) -> str:
        """The newest part of what it has said so far."""
        return self._palpate.connection.request("GET", "/jobs/{job}/log", job=self.id).text

    def metrics(self) -> list[dict[str, Any]]:
        """The newest part of its metrics, oldest first; `pandas.DataFrame(job.metrics())` is a table."""
        lines = self._palpate.connection.request("GET", "/jobs/{job}/metrics", job=self.id).text.splitlines()
        return [json.loads(line) for line in lines if line.strip()]

    def file(self, name: str) -> bytes:
        """A file that it has left, such as `report.json`, `report.html` or `model.toml`."""
        return self._palpate.connection.request("GET", "/jobs/{job}/files/{file}", job=self.id, file=name).content

    def wait(self, *, progress: bool = True, timeout_s: float | None = None) -> Job:
        """Waits until the job is done, with a progress bar unless `progress` is False.

        Raises PalpateError if it fails or is cancelled, or takes longer than `timeout_s`; in the last case, as with
        Ctrl-C, it goes on at the studio.
        """
        begun = time.monotonic()
        with progress_bar(f"{self.head.kind} {self.id}", progress) as show:
            while self.refresh().is_unfinished:
                show(self.head.fraction, self.head.stage or self.head.state, self.head.seconds_left)
                if timeout_s is not None and time.monotonic() - begun > timeout_s:
                    raise PalpateError("Timeout", f"job {self.id} has not ended within {timeout_s:g} s; it goes on")
                time.sleep(POLL_S)
            show(self.head.fraction, self.head.state, None)
        if self.head.state != "done":
            raise PalpateError(f"Job {self.head.state}", self.head.problem or f"{self.head.kind} {self.id}")
        return self


class Jobs:
    """The jobs of a studio. Iterating gives all of them, newest first."""

    def __init__(self, palpate: Palpate) -> None:
        self._palpate = palpate

    def __iter__(self) -> Iterator[Job]:
        return self.list()

    def list(self, *, state: str | None = None, kind: str | None = None) -> Iterator[Job]:
        """Jobs, newest first, page by page as they are read."""
        cursor = None
        while True:
            params = {"state": state, "kind": kind, "cursor": cursor}
            page = decode(JobPage, self._palpate.connection.json("GET", "/jobs", params=params))
            yield from (Job(self._palpate, head) for head in page.jobs)
            if page.next_cursor is None:
                return
            cursor = page.next_cursor

    def get(self, job: str) -> Job:
        """A job by its id."""
        return Job(self._palpate, decode(documents.Job, self._palpate.connection.json("GET", "/jobs/{job}", job=job)))

    def submit(
        self,
        kind: str,
        request: dict[str, Any],
        *,
        seed: int = 0,
        priority: int = 0,
        resources: dict[str, Any] | None = None,
        runner: str | None = None,
        key: str | None = None,
    ) -> Job:
        """Asks for a job.

        Args:
            kind: Kind of job, e.g. `diagnose`.
            request: What is asked, in the form of its kind.
            seed: Seed of everything random.
            priority: Jobs of a higher priority start first.
            resources: What it needs of the machine, e.g. `{"cores": 4}`; None means what its kind needs.
            runner: Where it runs; None means the studio's first runner.
            key: The same text again gives the same job again, instead of a second one.

        """
        body = {
            "kind": kind,
            "request": request,
            "seed": seed,
            "priority": priority,
            "resources": resources,
            "runner": runner,
        }
        headers = {"Idempotency-Key": key} if key else {}
        answer = self._palpate.connection.json("POST", "/jobs", body=body, headers=headers)
        return Job(self._palpate, decode(documents.Job, answer))

    def kinds(self) -> builtins.list[JobKindDocument]:
        """The kinds of jobs, and which of them the studio can do."""
        return decode(list[JobKindDocument], self._palpate.connection.json("GET", "/kinds"))

    def expert(
        self,
        object: str,
        *,
        preset: str | None = None,
        config: str | None = None,
        total_steps: int | None = None,
        script: str | Job | None = None,
        without_script: bool = False,
        model: str | Model | None = None,
        start_cm: float | None = None,
        silence_touch: bool = False,
        seed: int = 0,
        key: str | None = None,
    ) -> Job:
        """Trains an expert that grasps one object by touch, in simulation.

        Args:
            object: Id of the object.
            preset: How to learn: `quick` (without) or `paper`.
            config: The text of a configuration in place of a preset.
            total_steps: Steps of all environments together.
            script: What is learned on top of: a job of `tune`, or the name of a shipped script.
            without_script: Learn the whole motion.
            model: Saved sensor model that makes touch; None means the station's nominal one.
            start_cm: Half the edge length of the square that objects start in.
            silence_touch: The robot feels nothing.
            seed: Seed of everything random.
            key: The same text again gives the same job again.

        """
        return self._train(
            "expert",
            seed,
            key,
            object=object,
            preset=preset,
            config=config,
            total_steps=total_steps,
            script=script,
            without_script=without_script,
            model=model,
            start_cm=start_cm,
            silence_touch=silence_touch,
        )

    def evaluation(
        self,
        policy: str | Job,
        *,
        trials: int | None = None,
        protocol: str | None = None,
        objects: str | Iterable[str] | None = None,
        controls: bool = False,
        model: str | Model | None = None,
        start_cm: float | None = None,
        silence_touch: bool = False,
        seed: int = 0,
        key: str | None = None,
    ) -> Job:
        """Scores a policy in fresh trials, or under a protocol.

        `policy` is a job of `expert`, the name of a shipped policy, or, under a protocol, a job of `imitation` or
        `pipeline`.
        `objects` are ids, or one of `seen`, `unseen` and `all`; None means the policy's own.
        """
        return self._train(
            "evaluation",
            seed,
            key,
            policy=policy,
            trials=trials,
            protocol=protocol,
            objects=[objects] if isinstance(objects, str) else objects,
            controls=controls,
            model=model,
            start_cm=start_cm,
            silence_touch=silence_touch,
        )

    def demonstrations(
        self,
        policy: str | Job,
        count: int,
        *,
        shard_demos: int | None = None,
        model: str | Model | None = None,
        start_cm: float | None = None,
        seed: int = 0,
        key: str | None = None,
    ) -> Job:
        """Rolls a policy out until `count` trials have succeeded, and keeps these to learn from."""
        return self._train(
            "demonstrations",
            seed,
            key,
            policy=policy,
            count=count,
            shard_demos=shard_demos,
            model=model,
            start_cm=start_cm,
        )

    def pretraining(
        self,
        demonstrations: Iterable[str | Job],
        *,
        preset: str | None = None,
        config: str | None = None,
        epochs: int | None = None,
        without_positions: bool = False,
        silence_touch: bool = False,
        seed: int = 0,
        key: str | None = None,
    ) -> Job:
        """Pretrains the tactile encoder on the demonstrations of jobs."""
        return self._train(
            "pretraining",
            seed,
            key,
            demonstrations=demonstrations,
            preset=preset,
            config=config,
            epochs=epochs,
            without_positions=without_positions,
            silence_touch=silence_touch,
        )

    def gathering(
        self,
        objects: str | Iterable[str] | None = None,
        *,
        count: int | None = None,
        protocol: str | None = None,
        expert: str | None = None,
        model: str | Model | None = None,
        seed: int = 0,
        key: str | None = None,
    ) -> Job:
        """Lets an expert grasp, `count` times on each object, and keeps every trial to imitate.

        `objects` are ids, or one of `seen`, `unseen` and `all`; None means the seen ones. `expert` is `search`
        (without), `search:touch`, `search:tracking` or `repetition`.
        """
        return self._train(
            "gathering",
            seed,
            key,
            objects=[objects] if isinstance(objects, str) else objects,
            count=count,
            protocol=protocol,
            expert=expert,
            model=model,
        )

    def imitation(
        self,
        trials: Iterable[str | Job],
        *,
        preset: str | None = None,
        config: str | None = None,
        policy: str | None = None,
        head: str | None = None,
        memory: str | None = None,
        updates: int | None = None,
        silence_touch: bool = False,
        hide_tracking: bool = False,
        features: bool = False,
        encoder: str | Job | None = None,
        region: bool = False,
        only_won: bool = False,
        seed: int = 0,
        key: str | None = None,
    ) -> Job:
        """Learns to do what an expert did in the trials of jobs of `gathering`: one policy for all objects.

        Args:
            trials: Jobs of `gathering`.
            preset: How to learn: `small` (without) or `paper`.
            config: The text of a configuration in place of a preset.
            policy: A policy of the paper, `raw-dp`, `kinematic-dp`, `pretrained-dp`, `pretrained-act` or
                `pretrained-bc`. It says how touch is seen and what predicts, so leave `head` and `features` out.
            head: What predicts, `regression`, `diffusion` or `act`; None means the configuration's.
            memory: How the frames of a window are joined, `window` or `recurrent`; None means the configuration's.
            updates: Updates of the weights.
            silence_touch: The policy does not feel touch.
            hide_tracking: The policy does not see how far joints are from where they were sent.
            features: The policy sees the features that `encoder` makes of touch.
            encoder: A job of `pretraining`, whose encoder becomes part of the policy's file.
            region: The policy is told how wide the region is that objects begin in; `trials` have to be of several.
            only_won: Learn from the trials that were won only.
            seed: Seed of everything random.
            key: The same text again gives the same job again.

        """
        return self._train(
            "imitation",
            seed,
            key,
            trials=trials,
            preset=preset,
            config=config,
            policy=policy,
            head=head,
            memory=memory,
            updates=updates,
            silence_touch=silence_touch,
            hide_tracking=hide_tracking,
            features=features,
            encoder=encoder,
            region=region,
            only_won=only_won,
        )

    def pipeline(
        self,
        *,
        preset: str | None = None,
        config: str | None = None,
        model: str | Model | None = None,
        key: str | None = None,
    ) -> Job:
        """From a sensor model to policies that are scored: closings, gathered trials, trainings, evaluations, a report.

        Args:
            preset: What to do: `small` (without) or `paper`.
            config: The text of a configuration in place of a preset; seeds stand in it.
            model: Saved sensor model that makes touch; None means the station's nominal model.
            key: The same text again gives the same job again.

        """
        return self._train("pipeline", 0, key, preset=preset, config=config, model=model)

    def rollouts(
        self,
        campaign: str,
        *,
        repeat_void: bool = False,
        session: str | None = None,
        without_recording: bool = False,
        key: str | None = None,
    ) -> Job:
        """Makes the trials of a campaign on the hand. Somebody places each object and begins its trial at the page.

        The token needs the scope `control`: the job takes control of the robot.

        Args:
            campaign: Id of the campaign.
            repeat_void: Make trials that were scored void once more, after all others.
            session: Session that each trial becomes a take of; the campaign's id with `-takes` after it without one.
            without_recording: Record no takes.
            key: The same text again gives the same job again.

        """
        return self._train(
            "rollouts",
            0,
            key,
            campaign=campaign,
            repeat_void=repeat_void,
            session=session,
            without_recording=without_recording,
        )

    def comparison(self, campaign: str, *, models: Iterable[str | Model] = (), key: str | None = None) -> Job:
        """Makes the trials of a campaign once more in simulation, from the same starts, with each sensor model.

        Args:
            campaign: Id of the campaign; the records of its trials are those that jobs of kind `rollouts` left.
            models: Saved models; `nominal` is the station's own, which is compared alone without any.
            key: The same text again gives the same job again.

        """
        return self._train("comparison", 0, key, campaign=campaign, models=models)

    def tune(
        self,
        object: str,
        *,
        script: str | Job | None = None,
        generations: int | None = None,
        candidates: int | None = None,
        elite: int | None = None,
        trials: int | None = None,
        check_trials: int | None = None,
        model: str | Model | None = None,
        start_cm: float | None = None,
        seed: int = 0,
        key: str | None = None,
    ) -> Job:
        """Tunes a closing script on one object, in simulation."""
        return self._train(
            "tune",
            seed,
            key,
            object=object,
            script=script,
            generations=generations,
            candidates=candidates,
            elite=elite,
            trials=trials,
            check_trials=check_trials,
            model=model,
            start_cm=start_cm,
        )

    def _train(self, kind: str, seed: int, key: str | None, **request: object) -> Job:
        """Asks for a training; what is None is left to the studio, jobs and models go by their ids."""
        said = {name: _plain(value) for name, value in request.items() if value is not None}
        return self.submit(kind, said, seed=seed, key=key)


def _plain(value: object) -> object:
    if isinstance(value, str | int | float):
        return value
    if isinstance(value, Iterable):
        return [_plain(item) for item in value]
    return cast("Job | Model", value).id
