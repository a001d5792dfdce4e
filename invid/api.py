"""The functions behind ``import invid``, the commands and the service.

Recordings, models and diagnoses go in as they are and stay as they are; what comes out is immutable and can
be pickled. Errors are ``invid.InvidError`` and its kinds; an argument of the wrong kind is an
``InputError``. Each function loads what takes long to load when it is called.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from invid import arguments
from invid.effects.registry import registered_effects
from invid.errors import InputError, NotIdentifiableError
from invid.model import diagnosis_document
from invid.model.document import load_json
from invid.numerics.budget import Budget, Progress, use_budget
from invid.numerics.immutable import immutable
from invid.numerics.run_clock import RunClock
from invid.recording import hdf5
from invid.recording.concatenation import concatenate_recordings

if TYPE_CHECKING:
    from invid.comparison.answers import Screening
    from invid.comparison.changes import Comparison
    from invid.effects.effect import Effect
    from invid.exchange.export import Export
    from invid.model.diagnosis_document import Diagnosis
    from invid.model.document import Model
    from invid.recording.import_map import ImportMap
    from invid.recording.model import Recording
    from invid.simulators.guided import Simulator
    from invid.tuning.axis_loop import AxisLoop
    from invid.tuning.forms import WrittenTuning
    from invid.tuning.tune import Tuning

Masses = Sequence[int] | Literal["auto"] | None
Method = Literal["refined", "paper"]
Effects = Sequence["Effect | str | Path"]


def read_recording(path: str | Path) -> Recording:
    """The recording in an HDF5 file (format ``invid-recording``, docs/reference/recording.md).

    Returns
    -------
    Recording
        ``axes`` (M names) and ``experiments``; of each ``time`` (n,) [s], ``position`` (n, M) [rad or m],
        ``torque`` (n, M) [N·m or N].

    Raises
    ------
    RecordingError
        No file, no recording, or one that breaks its format: says the experiment and the entry.
    """
    return immutable(hdf5.read_recording(arguments.a_path(path, "path")))


def write_recording(recording: Recording, path: str | Path) -> None:
    """Write an ``invid-recording`` file (HDF5); RecordingError where that cannot be."""
    hdf5.write_recording(arguments.a_recording(recording), arguments.a_path(path, "path"))


def import_recording(
    source: str | Path | Sequence[str | Path],
    map: str | Path | ImportMap | None = None,  # the name of the contract
    *,
    created: str | None = None,
) -> Recording:
    """A recording from a log of another tool: CSV, MAT, Parquet, HDF5, CAN logs.

    Parameters
    ----------
    source
        A file, several, or a folder that the map's ``file`` patterns pick from.
    map
        YAML map of columns, units and roles (docs/reference/recording.md); ``None`` where every column's
        meaning is plain from its name, or where the file is a recording already.
    created
        ISO 8601 time that the recording is given; default: now.

    Returns
    -------
    Recording
        ``attributes["broken_rows"]`` rows were skipped; what else was assumed is a Python warning.

    Raises
    ------
    InputError
        A file or map that cannot be used, or columns that nobody can tell without a map.
    """
    from invid.recording.import_map import ImportMap, load_map
    from invid.recording.import_source import import_source

    given = arguments.paths(source, "source")
    chart = map if map is None or isinstance(map, ImportMap) else load_map(arguments.a_path(map, "map"))
    beside = None if map is None or isinstance(map, ImportMap) else Path(map).parent
    arguments.a_time(created, "created")
    now = created or datetime.now(UTC).isoformat(timespec="seconds")
    result = import_source(given, chart, created=now, beside=beside)
    for text in result.warnings:
        warnings.warn(text, stacklevel=2)
    return immutable(result.recording)


def identify(
    recording: Recording | Sequence[Recording],
    *,
    masses: Masses = None,
    method: Method = "refined",
    budget: float | None = None,
    progress: Callable[[Progress], None] | None = None,
    effects: Effects = (),
) -> Model:
    """Masses, springs, dampers and inertia couplings of every branch with their uncertainty.

    Parameters
    ----------
    recording
        One recording, or several of one machine (see ``diagnose``).
    masses
        Masses of each axis, as ``[3, 3, 3]``; "auto": as many as the data need; default: what the recording
        names, else "auto".
    method
        "refined" (maximum likelihood) or "paper" (the inverse eigenvalue method alone).
    budget
        Seconds of processor time, helper processes included (and at most twice as many that go by), after
        which the best answer so far is given, with a warning that says what was not looked at; ``None``: as
        long as it takes, and the same data give the same answer.
    progress
        Called with an ``invid.Progress`` (``stage``, ``axis``, ``cause``, ``fraction``, ``seconds_left``) as
        the work goes on.
    effects
        See ``diagnose``.

    Returns
    -------
    Model
        ``chains.masses`` and ``chains.springs`` by axis [kg·m², N·m/rad; linear axes: kg, N/m], ``std`` in
        the same shapes. ``fit["trustworthy"]`` is False where a reason stands in ``warnings``.

    Raises
    ------
    InputError
        An axis that moves and is never excited; masses that do not match the axes.
    NotIdentifiableError
        Data from which no such model can be drawn.
    """
    from invid.identification.identify import identify as identified

    one = _one(recording)
    arguments.one_of(method, "method", ("refined", "paper"))
    with _using(effects), _limits(budget, progress):
        return immutable(identified(one, masses=arguments.mass_counts(masses, one.axes), method=method))


def diagnose(  # noqa: PLR0913 - the contract: each is one option of the command
    recording: Recording | Sequence[Recording],
    *,
    model: Model | Diagnosis | None = None,
    masses: Masses = None,
    budget: float | None = None,
    progress: Callable[[Progress], None] | None = None,
    effects: Effects = (),
    against: str | Path | None = None,
    corrected: str | Path | None = None,
) -> Diagnosis:
    """What the simulation gets wrong on a recording: cause, place, size, extended model and gain.

    Parameters
    ----------
    recording
        One recording, or several of one machine that are diagnosed together: one plant and one set of
        causes, each experiment with its own noise. A load or an offset that differs between them is not
        told apart yet: it is one cause for all, or is left unexplained.
    model
        Where to start, and, where it comes from another recording, the accepted model with which the result
        is compared; default: what ``identify`` makes of the recording with ``masses``.
    budget, progress
        As for ``identify``. A search that the budget ended calls nothing ``consistent`` and no finding surer
        than 0.89; ``details["cut_short"]`` is then True.
    effects
        Causes beside the catalogue's: ``invid.effects.Effect`` objects, or files that hold ``EFFECT``
        (docs/how-to/add-an-effect.md). A model that has one needs it again to be simulated or diagnosed.
    against, corrected
        A simulator of the same machine (MuJoCo XML, URDF, invid model or FMU), run by its own engine on the
        records kept out: the result's ``against`` says what it gets wrong; ``corrected`` is where its
        corrected copy goes (docs/how-to/against.md).

    Returns
    -------
    Diagnosis
        ``verdict``, ``findings`` (``cause``, ``axis``, ``element``, ``parameters["torque"].value`` and
        ``.std``, ``confidence``, ``alternatives``), ``residual`` of each axis [N·m or N], ``model`` (with the
        causes as its effects), ``changes`` since the model given, ``headline``, ``warnings``.

    Raises
    ------
    InputError
        Recordings that are not of one machine; a model of other axes; ``model`` and ``masses`` together.
    NotIdentifiableError
        Data from which no model can be drawn.
    """
    from invid.comparison.answers import with_changes, with_stated_inertia
    from invid.comparison.compare import compare as compared
    from invid.diagnosis.diagnose import diagnose as diagnosed

    one = _one(recording)
    if model is not None and masses is not None:
        raise InputError("masses and model: the model says how many masses there are; give one of the two")
    start = None if model is None else arguments.a_model(model)
    sizes = arguments.mass_counts(masses, one.axes)
    simulator, copy = _simulator(against, corrected, one.axes)
    with _using(effects), _limits(budget, progress):
        if simulator is not None and start is None and sizes is None:
            claimed = simulator.claimed()
            sizes = None if claimed is None else list(claimed.chains.masses_per_branch)
        result = diagnosed(one, model=start, masses=sizes)
        if simulator is not None:
            from invid.simulators.judge import judge

            result = replace(result, against=judge(one, result, simulator, copy))
        other = start is not None and start.provenance.get("recorded") != one.created
        if start is not None and other and start.linear == result.model.linear:
            result = with_changes(result, compared(start, result.model))
        return immutable(with_stated_inertia(result, one, start))


def screen(
    recording: Recording,
    model: Model | Diagnosis,
    *,
    budget: float | None = None,
    progress: Callable[[Progress], None] | None = None,
) -> Screening:
    """Whether anything changed since an accepted model, by a short record of its machine.

    Returns
    -------
    Screening
        ``verdict`` ("unchanged", "changed" or "cannot tell"), the axes ``changed``, a ``sentence``, the
        ``comparison`` of the two models and the record's ``diagnosis``.

    Raises
    ------
    ModelError
        A model without a covariance, or of other axes.
    """
    from invid.comparison.answers import Screening, judge_screening, require_screenable, with_its_causes
    from invid.comparison.compare import compare as compared

    one, start = _one(recording), arguments.a_model(model)
    require_screenable(start, one.axes)
    try:
        found = diagnose(one, model=with_its_causes(start), budget=budget, progress=progress)
    except NotIdentifiableError as error:
        return Screening("cannot tell", (), f"cannot tell: {error}", None, None)
    return judge_screening(found, start, compared(start, found.model))


def simulate(
    model: Model | Diagnosis,
    recording: Recording,
    *,
    rng: np.random.Generator | None = None,
    only: Collection[str] | None = None,
    effects: Effects = (),
) -> Recording:
    """The answer of a model, effects included, to the torques of a recording, over time.

    Parameters
    ----------
    rng
        Draws the rows that ``dropped_samples`` repeats; default: the same rows each time.
    only
        Keys of the experiments to simulate and to return; default: all.
    effects
        See ``diagnose``.

    Returns
    -------
    Recording
        The same experiments; ``position`` (n, M) from the model, ``torque`` what it was given.

    Raises
    ------
    InputError, ModelError
        Axes that do not match; an effect that cannot be simulated; motion that diverges.
    """
    from invid.simulation.run import simulate as simulated

    arguments.a_generator(rng)
    chosen = arguments.experiment_keys(only, arguments.a_recording(recording))
    with _using(effects):
        return immutable(simulated(arguments.a_model(model), recording, rng=rng, only=chosen))


def compare(
    old: Model | Diagnosis,
    new: Model | Diagnosis,
    *,
    tolerance: float = 0.2,
    alpha: float = 0.01,
    repeatability: float = 0.0,
) -> Comparison:
    """Which parameters and causes changed between two models of one robot, beyond their uncertainty.

    Parameters
    ----------
    tolerance
        A parameter that could have changed by more than this fraction unseen is not called unchanged.
    alpha
        Probability of a false "changed" over all parameters.
    repeatability
        Relative standard deviation between measurements of an unchanged robot.

    Returns
    -------
    Comparison
        ``sentences``, and of each parameter ``status``, ``difference`` and ``std`` in its unit.

    Raises
    ------
    InputError
        Models of robots that have nothing in common.
    """
    from invid.comparison.compare import compare as compared

    for name, value in (("tolerance", tolerance), ("alpha", alpha), ("repeatability", repeatability)):
        arguments.a_number(value, name, "give a number")
    before, after = arguments.a_model(old, "old"), arguments.a_model(new, "new")
    return immutable(compared(before, after, tolerance=tolerance, alpha=alpha, repeatability=repeatability))


def export(model: Model | Diagnosis, to: str, path: str | Path) -> Export:
    """Write a model for another tool, with its covariance and what the format cannot hold beside it.

    Parameters
    ----------
    to
        "statespace" (MAT file), "mjcf" (MuJoCo), "urdf" (springs by Gazebo's convention) or "fmu" (FMI 3).
        All but the first and "urdf" need the extra ``invid[export]``.
    path
        The file; ``path`` with ``.json`` after it gets names, values and covariance (p, p) of the parameters,
        the losses and the model itself.

    Returns
    -------
    Export
        ``path``, ``beside``, ``losses`` and ``warnings`` in sentences.

    Raises
    ------
    InputError
        A format that does not exist, a package that is missing, a file that cannot be written.
    """
    from invid.exchange.export import export_model, format_names

    if not isinstance(to, str):
        arguments.one_of(to, "to", format_names())
    return export_model(arguments.a_model(model), to, arguments.a_path(path, "path"))


def tune(
    source: Model | Diagnosis,
    *,
    before: str | Path | Mapping[str, AxisLoop] | None = None,
    cycle: float = 0.001,
    notches: int = 2,
    draws: int = 200,
    ripple: float = 0.01,
) -> Tuning:
    """Gains, notch filters, feedforward and shapers for the drives of a model, with the margins they leave.

    Parameters
    ----------
    source
        A model, or a diagnosis: causes that it leaves open then count, and the loops are designed for the
        worse.
    before
        An ``invid-tuning`` file with the values in the drives now, for the comparison, or loops by axis; an
        axis without: timid gains.
    cycle
        Of the drives' loops [s].
    notches
        At most this many an axis.
    draws
        Machines drawn from the model's covariance in which the margins are to hold.
    ripple
        Torque that the encoders' counts may make, rms, as a share of rated torque.

    Returns
    -------
    Tuning
        ``axes`` with gains, feedforward, shaper, margins and the reference move, each before and after.
        ``invid.write_tuning`` writes the files.

    Raises
    ------
    NotIdentifiableError
        The model is not to be trusted, too unsure for any gains, or leaves open what the loops would feel.
    """
    from invid.tuning.axis_loop import loops_from_json
    from invid.tuning.servo_loop import DriveTiming
    from invid.tuning.tune import TuneSettings, tune_model

    arguments.a_number(cycle, "cycle", "give the cycle of the drives' loops in seconds", above=0.0)
    arguments.a_number(ripple, "ripple", "give a share of rated torque, as 0.01", above=0.0)
    model, old = arguments.a_model(source), None
    if isinstance(before, Mapping):
        old = before
    elif before is not None:
        path = arguments.a_path(before, "before")
        old = loops_from_json(load_json(path), str(path))
    if strange := set(old or ()) - set(model.axes):
        raise InputError(f"before: {min(strange)!r} is no axis of the model; it has {list(model.axes)}")
    settings = TuneSettings(DriveTiming(cycle), notches, draws, ripple=ripple)
    return immutable(tune_model(source, settings, old))


def write_tuning(
    tuning: Tuning, folder: str | Path, *, drive: str | None = None, motors: str | Path | None = None
) -> WrittenTuning:
    """Write a tuning as files: a page, a document, and the forms that controllers read; never to a drive.

    ``drive`` adds the drive's own objects, for which ``motors``, a YAML file, says gear and torque constant
    of each axis (docs/how-to/tune.md). The result names the files, and what each form does not hold.
    """
    from invid.tuning.forms import read_motors
    from invid.tuning.forms import write_tuning as write

    known = None if motors is None else read_motors(arguments.a_path(motors, "motors"))
    return write(tuning, arguments.a_path(folder, "folder"), drive=drive, motors=known)


def load_model(path: str | Path) -> Model:
    """The model in an ``invid-model`` file (JSON), or the extended one in an ``invid-diagnosis`` file.

    InputError or ModelError says what is wrong with it.
    """
    return immutable(diagnosis_document.load_model(arguments.a_path(path, "path")))


def load_diagnosis(path: str | Path) -> Diagnosis:
    """The diagnosis in an ``invid-diagnosis`` file (JSON); InputError says what is wrong with it."""
    return immutable(diagnosis_document.load_diagnosis(arguments.a_path(path, "path")))


@contextmanager
def _limits(seconds: float | None, report: Callable[[Progress], None] | None) -> Iterator[None]:
    """Budget and progress of one call. Trial steps of a search may overflow: that is judged, not printed."""
    if seconds is not None:
        arguments.a_number(seconds, "budget", "give a number of seconds above 0", above=0.0)
    arguments.a_function(report, "progress")
    end = None if seconds == float("inf") else seconds
    own = None if end is None and report is None else Budget(end, RunClock(), report)
    with use_budget(own), np.errstate(all="ignore"):
        yield


def _simulator(
    against: str | Path | None, corrected: str | Path | None, axes: tuple[str, ...]
) -> tuple[Simulator | None, Path | None]:
    """The simulator in a file, and where its corrected copy goes."""

    if against is None:
        if corrected is not None:
            raise InputError("corrected: needs against, the simulator that is corrected")
        return None, None
    from invid.simulators.open import open_simulator

    copy = None if corrected is None else arguments.a_path(corrected, "corrected")
    return open_simulator(arguments.a_path(against, "against"), axes), copy


def _using(effects: Effects) -> AbstractContextManager[None]:
    return registered_effects(arguments.effect_list(effects))


def _one(recording: Recording | Sequence[Recording]) -> Recording:
    """One recording of all that are given."""
    return concatenate_recordings(arguments.recordings(recording))
