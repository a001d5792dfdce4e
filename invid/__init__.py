"""invid: field identification of elastic robot drives, and what the simulation still gets wrong.

>>> recording = invid.read_recording("rec.h5")
>>> diagnosis = invid.diagnose(recording)
>>> diagnosis.verdict, diagnosis.findings[0].cause

The names below are loaded when they are first used, so that ``import invid`` costs nothing.
"""

import os
from importlib import import_module
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from invid.api import (
        compare,
        diagnose,
        export,
        identify,
        import_recording,
        load_diagnosis,
        load_model,
        read_recording,
        screen,
        simulate,
        tune,
        write_recording,
        write_tuning,
    )
    from invid.comparison.changes import Comparison
    from invid.errors import (
        BusError,
        ConfigError,
        DiskFullError,
        DriveError,
        InputError,
        InvidError,
        ModelError,
        NotIdentifiableError,
        RecordingError,
        SafetyStop,
    )
    from invid.model.diagnosis_document import Diagnosis
    from invid.model.document import Model
    from invid.numerics.budget import Progress
    from invid.recording.model import Experiment, Recording
    from invid.tuning.tune import Tuning

    __version__: str

# All linear algebra here is many small matrices. BLAS threads that wait for each other on them cost a
# factor of ten in time on a busy machine (measured: a diagnosis 65 s instead of 14 s of CPU), so they
# are off unless the environment asks for them. Takes effect where numpy is not imported yet.
for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

__all__ = [
    "BusError",
    "Comparison",
    "ConfigError",
    "Diagnosis",
    "DiskFullError",
    "DriveError",
    "Experiment",
    "InputError",
    "InvidError",
    "Model",
    "ModelError",
    "NotIdentifiableError",
    "Progress",
    "Recording",
    "RecordingError",
    "SafetyStop",
    "Tuning",
    "compare",
    "diagnose",
    "export",
    "identify",
    "import_recording",
    "load_diagnosis",
    "load_model",
    "read_recording",
    "screen",
    "simulate",
    "tune",
    "write_recording",
    "write_tuning",
]

_HOMES = {
    "Comparison": "invid.comparison.changes",
    "Diagnosis": "invid.model.diagnosis_document",
    "Experiment": "invid.recording.model",
    "Model": "invid.model.document",
    "Progress": "invid.numerics.budget",
    "Recording": "invid.recording.model",
    "Tuning": "invid.tuning.tune",
}
"""Where the types are; functions are in ``invid.api``, errors in ``invid.errors``."""


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return version("invid")
    if name not in __all__:
        raise AttributeError(f"module 'invid' has no attribute {name!r}")
    home = _HOMES.get(name) or ("invid.api" if name[0].islower() else "invid.errors")
    value = getattr(import_module(home), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, "__version__"})
