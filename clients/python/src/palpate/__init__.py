"""Client of a Palpate studio: sessions and takes as arrays, calibrations, diagnoses, the live hand, control of it.

from palpate import Palpate

with Palpate() as p:
    report = p.calibrate("demo").wait()
    print(report.held_out.nominal.f1, "->", report.held_out.calibrated.f1)
"""

from palpate.client import Model, Palpate, Session, Take
from palpate.control import Control
from palpate.errors import PalpateError
from palpate.jobs import Job
from palpate.runs import CalibrationRun, DiagnosisRun, Run
from palpate.station import Station
from palpate.traces import Frame, Replay, StreamSamples, Trace, to_pandas

__all__ = [
    "CalibrationRun",
    "Control",
    "DiagnosisRun",
    "Frame",
    "Job",
    "Model",
    "Palpate",
    "PalpateError",
    "Replay",
    "Run",
    "Session",
    "Station",
    "StreamSamples",
    "Take",
    "Trace",
    "to_pandas",
]
__version__ = "0.1.0"
