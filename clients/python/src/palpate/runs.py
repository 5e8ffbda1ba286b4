"""Calibrations and diagnoses under way."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, ClassVar, Generic, TypeVar

from tqdm.auto import tqdm

from palpate.documents import CalibrationReport, DiagnosisReport, ModelSummary, decode
from palpate.errors import PalpateError

if TYPE_CHECKING:
    from palpate.client import Model, Palpate

R = TypeVar("R")
POLL_S = 0.25
"""How often a run is asked for, s."""


@contextlib.contextmanager
def progress_bar(what: str, shown: bool) -> Iterator[Callable[[float, str, float | None], None]]:
    """A progress bar in terminal or notebook; gives what draws a share, a stage and the seconds that are left."""
    form = "{desc}: {percentage:3.0f}%|{bar}| {elapsed}{postfix}"
    with tqdm(total=1.0, desc=what, bar_format=form, disable=not shown) as bar:

        def show(fraction: float, stage: str, seconds_left: float | None) -> None:
            bar.n = min(fraction, 1.0)
            bar.set_postfix_str(stage if seconds_left is None else f"{stage}, about {seconds_left:.0f} s left")

        yield show


class Run(Generic[R]):
    """A run at the studio. It goes on there whatever becomes of this program.

    Attributes:
        id: Id of the run.
        request: What was asked.
        state: `queued`, `running`, `done`, `failed` or `cancelled`, as of the last `refresh`.
        fraction: Done so far, 0 to 1.
        stage: What is being done, for people.
        seconds_left: Estimated time left, s.
        error: Why it failed.
        report: The result, once done.
        model_toml: The model file that was found, once done.
        saved_as: Id under which the model was saved, once it was.

    """

    WORD: ClassVar[str]
    REPORT: ClassVar[type]
    DETAIL: ClassVar[tuple[str, str]]
    CANCEL: ClassVar[tuple[str, str]]
    SAVE: ClassVar[tuple[str, str]]
    HTML: ClassVar[tuple[str, str]]
    TABLE: ClassVar[tuple[str, str]]

    def __init__(self, palpate: Palpate, document: dict[str, Any]) -> None:
        self._palpate = palpate
        self._read(document)

    def _read(self, document: dict[str, Any]) -> None:
        self.id: str = document["id"]
        self.request: dict[str, Any] = document["request"]
        self.state: str = document["state"]
        self.fraction: float = document["fraction"]
        self.stage: str = document["stage"]
        self.seconds_left: float | None = document["seconds_left"]
        self.error: str | None = document["error"]
        self.report: R | None = decode(self.REPORT, document["report"])
        self.model_toml: str | None = document["model_toml"]
        self.saved_as: str | None = document["saved_as"]

    def __repr__(self) -> str:
        return f"<{self.WORD} {self.id} of {self.request.get('session')}: {self.state}, {self.fraction:.0%}>"

    @property
    def is_unfinished(self) -> bool:
        """Whether it waits or works."""
        return self.state in ("queued", "running")

    def refresh(self) -> Run[R]:
        """Asks the studio where the run stands."""
        self._read(self._palpate.connection.json(*self.DETAIL, run=self.id))
        return self

    def wait(self, *, progress: bool = True, timeout_s: float | None = None) -> R:
        """Waits for the result and gives it, with a progress bar unless `progress` is False.

        Raises PalpateError if the run fails or is cancelled, or takes longer than `timeout_s`; in the last case, as
        with Ctrl-C, it goes on at the studio.
        """
        begun = time.monotonic()
        with progress_bar(f"{self.WORD} of {self.request.get('session')}", progress) as show:
            while self.refresh().is_unfinished:
                show(self.fraction, self.stage or self.state, self.seconds_left)
                if timeout_s is not None and time.monotonic() - begun > timeout_s:
                    raise PalpateError(
                        "Timeout", f"{self.WORD} {self.id} has not ended within {timeout_s:g} s; it goes on"
                    )
                time.sleep(POLL_S)
            show(self.fraction, self.state, None)
        if self.report is None:
            raise PalpateError(
                f"{self.WORD} {self.state}", self.error or f"{self.WORD} {self.id} of {self.request['session']}"
            )
        return self.report

    def cancel(self) -> Run[R]:
        """Asks the run to end."""
        self._read(self._palpate.connection.json(*self.CANCEL, run=self.id))
        return self

    def table(self, name: str) -> str:
        """Numbers of the report as CSV.

        `name` is `metrics.csv`; of a calibration also `intervals.csv`, of a diagnosis `effects.csv` or `waterfall.csv`.
        """
        return self._palpate.connection.request(*self.TABLE, run=self.id, file=name).text

    def html(self) -> str:
        """The report as one self-contained page."""
        return self._palpate.connection.request(*self.HTML, run=self.id).text

    def _save(self, body: dict[str, Any]) -> Model:
        from palpate.client import Model

        saved = decode(ModelSummary, self._palpate.connection.json(*self.SAVE, body=body, run=self.id))
        self.saved_as = saved.id
        return Model(self._palpate, saved)


class CalibrationRun(Run[CalibrationReport]):
    """A calibration."""

    WORD = "calibration"
    REPORT = CalibrationReport
    DETAIL = ("GET", "/calibrations/{run}")
    CANCEL = ("POST", "/calibrations/{run}/cancel")
    SAVE = ("POST", "/calibrations/{run}/save")
    HTML = ("GET", "/calibrations/{run}/report.html")
    TABLE = ("GET", "/calibrations/{run}/tables/{file}")

    def save(self, name: str) -> Model:
        """Keeps the calibrated model under a name for people, of which its id is made."""
        return self._save({"name": name})


class DiagnosisRun(Run[DiagnosisReport]):
    """A diagnosis."""

    WORD = "diagnosis"
    REPORT = DiagnosisReport
    DETAIL = ("GET", "/diagnoses/{run}")
    CANCEL = ("POST", "/diagnoses/{run}/cancel")
    SAVE = ("POST", "/diagnoses/{run}/save")
    HTML = ("GET", "/diagnoses/{run}/report.html")
    TABLE = ("GET", "/diagnoses/{run}/tables/{file}")

    def save(self, name: str | None = None, *, to: str | None = None, effects: list[int] | None = None) -> Model:
        """Keeps the model with the named effects as a new one, or adds them to the model with id `to`.

        `effects` chooses among the named ones by their position in the report; None means all.
        """
        return self._save({"name": name, "to": to, "effects": effects})
