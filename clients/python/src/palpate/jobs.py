"""Jobs of every kind: long work that the studio does, whatever becomes of this program."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import palpate.documents as documents
from palpate.documents import JobPage, decode
from palpate.errors import PalpateError
from palpate.runs import POLL_S, progress_bar

if TYPE_CHECKING:
    from palpate.client import Palpate


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
