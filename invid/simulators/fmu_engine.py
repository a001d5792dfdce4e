"""An FMU (FMI 2 or 3, co-simulation) as a simulator: torques in, positions out, driven by fmpy.

Axis A1 is the input ``A1``, ``A1.torque`` or ``torque.A1``, the output ``A1.position`` or ``position.A1``;
without such names inputs and outputs stand in the order of the axes. An output of the velocity is used where
there is one, else differences of the position. Parameters named as an invid model's (``A1.mass.1``) are read
and corrected.

It is native code of somebody else: it runs in a process of its own, whose end is an error that names the
file.
"""

from __future__ import annotations

import json
import re
import shutil
import tempfile
import weakref
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
from fmpy.simulation import (
    apply_start_values,
    instantiate_fmu,
    settable_in_initialization_mode,
    settable_in_instantiated,
)

from invid.errors import InputError
from invid.exchange.linear_plant import effect_name
from invid.model.chains import CoupledChains
from invid.model.document import ChainStd, Model, parameter_vector, save_text
from invid.numerics.arrays import Float64
from invid.processes import Helper, ProcessEnded
from invid.recording.units import FACTORS, Quantity, factor, normal_unit
from invid.simulators.guided import GUIDE, Guided, stiff_guide

LARGEST_STEP = 0.2
"""Rate of the guide times the communication step: the guide sees the motion as it was a step ago."""
LARGEST_FIXED = 0.5
"""The same where the FMU takes one step alone: near the guide's limit, as a softer guide holds less."""
SOFTER = 4
"""Guides, each half as fast as the last, that are tried on such an FMU: how late it moves is its solver's,
and that limits a guide."""
RUN_AWAY = 100.0
"""Largest torque of a guide over the largest recorded one: what is beyond is a guide that shakes."""
LONGEST_S = 900.0
"""Time in which an experiment is simulated, else the FMU hangs."""
TRIED = 1e-3
"""Seconds of the steps from which the inertia that a motor shows is taken."""


@dataclass(frozen=True)
class _Channel:
    """A variable by its reference; ``factor`` is the SI value of its unit."""

    reference: int
    factor: float = 1.0


_WORDS = {
    "torque": r"tau|torque|trq|force|moment|effort|(^|[^a-z])u([^a-z]|$)",
    "position": r"pos|angle|theta|phi|(^|[^a-z])q([^a-z]|$)",
    "velocity": r"vel|speed|omega|(^|[^a-z])(w|dq|qd)([^a-z]|$)",
}


def _tells(variable: Any, what: Quantity) -> bool:
    """Whether name or unit say that a variable is this."""
    unit = normal_unit(variable.unit or getattr(variable.declaredType, "unit", None) or "")
    words = [q for q in _WORDS if re.search(_WORDS[q], variable.name.lower())]
    return words == [what] if words else unit in FACTORS[what]


def _fixed_step(description: Any) -> float | None:
    """The one communication step [s] that an FMU takes, where it takes no other."""
    how = description.coSimulation
    if how.canHandleVariableCommunicationStepSize:
        return None
    stated = getattr(how, "fixedInternalStepSize", None)
    stated = stated or (description.defaultExperiment and description.defaultExperiment.stepSize)
    return float(stated) if stated else None


class FmuSimulator:
    """One FMU, unpacked; ``values`` of its parameters by name in place of its own."""

    def __init__(self, path: Path, axes: tuple[str, ...], values: Mapping[str, float] | None = None) -> None:
        self.path, self.axes = str(path), axes
        try:
            self.description: Any = fmpy.read_model_description(str(path), validate=False)
        except Exception as error:
            raise InputError(f"{path}: no FMU that fmpy reads: {error}") from None
        if self.description.coSimulation is None:
            raise InputError(f"{path}: is for model exchange alone; --against takes FMUs for co-simulation")
        supported = fmpy.supported_platforms(str(path))
        if fmpy.platform not in supported:
            raise InputError(
                f"{path}: has a library for {', '.join(supported) or 'no platform'} alone, and this machine "
                f"is {fmpy.platform}; export it for that, or with its sources and run 'fmpy compile "
                f"{path.name}'"
            )
        self.engine = f"FMI {self.description.fmiVersion} by fmpy {fmpy.__version__}"
        variables = {v.name: v for v in self.description.modelVariables}
        self.parameters = {n: v for n, v in variables.items() if v.causality == "parameter"}
        folder = tempfile.mkdtemp(prefix="invid-fmu-")
        weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)
        self.step = _fixed_step(self.description) or 0.0
        self._plant = _Fmu(
            self.path,
            fmpy.extract(str(path), folder),
            self.description,
            self._found(variables, "input", "torque"),
            self._found(variables, "output", "position"),
            self._found(variables, "output", "velocity", needed=False),
            self.step,
            dict(values or {}),
        )
        self._helper = Helper()

    def _found(
        self, variables: Mapping[str, Any], causality: str, what: Quantity, *, needed: bool = True
    ) -> list[_Channel]:
        here = [v for v in variables.values() if v.causality == causality]
        real = [v for v in here if v.type.startswith(("Real", "Float"))]
        named = [[v for v in real if v.name in (f"{a}.{what}", f"{what}.{a}", a)] for a in self.axes]
        if all(named):
            return [self._channel(n[0], what) for n in named]
        # Without such names by their quantity, as name or unit tell it, in the order of the axes.
        own = [v for v in real if _tells(v, what)]
        if len(own) == len(self.axes):
            return [self._channel(v, what) for v in own]
        if not needed:
            return []
        if len(real) == len(self.axes):
            return [self._channel(v, what) for v in real]
        raise InputError(
            f"{self.path}: no {causality} for the {what} of every axis ({', '.join(self.axes)}); it has "
            f"{', '.join(v.name for v in real) or 'none'}: name them AXIS.{what}"
        )

    def _channel(self, variable: Any, what: Quantity) -> _Channel:
        """A variable with the SI value of its unit, by the file's own definition, else by the unit's name."""
        unit = variable.unit or getattr(variable.declaredType, "unit", None) or ""
        base = next((u.baseUnit for u in self.description.unitDefinitions if u.name == unit), None)
        if base is not None and any(getattr(base, p) for p in ("kg", "m", "s", "rad")):
            return _Channel(variable.valueReference, float(base.factor or 1.0))
        if not unit:
            return _Channel(variable.valueReference)
        where = f"{self.path}: variable {variable.name}"
        return _Channel(variable.valueReference, factor(what, unit, {}, where))

    def prepared(self, records: Sequence[Guided]) -> list[str]:
        """See ``Simulator.prepared``."""
        return []

    def claimed(self) -> Model | None:
        """The chains that its parameters are, where they are named as an invid model's."""
        known = {n: self._plant.values.get(n, float(v.start or 0.0)) for n, v in self.parameters.items()}

        def row(axis: str, kind: str) -> list[float]:
            numbers: list[float] = []
            while f"{axis}.{kind}.{len(numbers) + 1}" in known:
                numbers.append(known[f"{axis}.{kind}.{len(numbers) + 1}"])
            return numbers

        masses = [row(a, "mass") for a in self.axes]
        springs, dampers = ([row(a, kind) for a in self.axes] for kind in ("spring", "damper"))
        if not all(masses) or any(len(k) != len(m) - 1 for k, m in zip(springs, masses, strict=True)):
            return None
        couplings = np.zeros((len(self.axes),) * 2)
        for i, a in enumerate(self.axes):
            for j, b in enumerate(self.axes):
                couplings[i, j] = known.get(f"{a}-{b}.coupling", known.get(f"{b}-{a}.coupling", 0.0))
        np.fill_diagonal(couplings, 0.0)
        chains = CoupledChains.build(masses, springs, dampers, couplings, axes=self.axes)
        name = self.description.modelName
        return Model(robot=name, method="fmu", chains=chains, std=ChainStd.unknown(chains))

    def guide(self, given: Guided) -> tuple[Float64, Float64]:
        """See ``Simulator.guide``; the guide is closed between steps, from the FMU's own start: it cannot be
        started in motion."""
        alone = f"try it alone: 'fmpy simulate {Path(self.path).name}'"
        try:
            force, position = self._helper.call(_guide, self._plant, given, timeout=LONGEST_S)
        except TimeoutError:
            raise InputError(
                f"{self.path}: the FMU has not simulated experiment {given.key} in {LONGEST_S:g} s; {alone}"
            ) from None
        except ProcessEnded as ended:
            raise InputError(
                f"{self.path}: the FMU's own code ended its process {ended} in experiment {given.key} (it "
                f"said: {(ended.said or 'nothing')[:200]}); {alone}"
            ) from None
        return force, position

    def corrected(self, model: Model, to: Path) -> tuple[FmuSimulator, Sequence[str]]:
        """Start values of its parameters as JSON: nobody can change an FMU's equations from outside."""
        names, numbers = parameter_vector(model.chains)
        values = {n: float(x) for n, x in zip(names, numbers, strict=True) if n in self.parameters}
        lost = [f"{n}, which is no parameter of the FMU" for n in names if n not in values]
        lost += [effect_name(t) for t in model.effects]
        document = {"format": "invid-fmu-parameters", "fmu": Path(self.path).name, "start_values": values}
        save_text(to, json.dumps({**document, "cannot_hold": lost}, indent=1, ensure_ascii=False))
        return FmuSimulator(Path(self.path), self.axes, values), lost


def _guide(plant: _Fmu, given: Guided) -> tuple[Float64, Float64]:
    """What ``FmuSimulator.guide`` gives, in this process; InputError where it fails."""
    try:
        return plant.guided(given)
    except InputError:
        raise
    except Exception as error:  # the FMU's library, its binding, or what either of them loads
        said = (str(error).strip().splitlines() or [type(error).__name__])[0][:200]
        raise InputError(f"{plant.path}: the FMU fails: {said}; try it alone: 'fmpy simulate'") from None


@dataclass(frozen=True, eq=False)
class _Fmu:
    """An unpacked FMU with what to write and read; ``step`` [s] is the one it takes, 0 where it takes any."""

    path: str
    folder: str
    description: Any
    inputs: list[_Channel]
    outputs: list[_Channel]
    velocities: list[_Channel]
    step: float
    values: dict[str, float]

    def guided(self, given: Guided) -> tuple[Float64, Float64]:
        """Torque of the guide at the samples, and positions."""
        rate = 2 * np.pi * GUIDE * given.high
        longest, tried = LARGEST_STEP / rate, 1
        if self.step:
            longest, tried = given.interval / self._steps_of(given.interval), SOFTER
            rate = min(rate, LARGEST_FIXED / longest)
        inertia = self._inertia()
        for softer in range(tried):
            force, position = self._run(given, stiff_guide(inertia, rate / 2**softer), longest)
            if np.isfinite(force).all() and np.abs(force).max() < RUN_AWAY * np.abs(given.torque).max():
                return force, position
        coarse = f": its step of {self.step:g} s is too coarse to be guided" if self.step else ""
        raise InputError(f"{self.path}: the simulation of experiment {given.key} runs away{coarse}")

    def _run(self, given: Guided, guide: tuple[Float64, Float64], longest: float) -> tuple[Float64, Float64]:
        """(n, M) torque of the guide and positions, in steps of ``longest`` [s] at most."""
        every, torque, position, velocity = given.fine(longest, torque=0.5)
        step, (stiffness, damping) = given.interval / every, guide
        # A torque held over a step has lost (ωh)²/24 of a sine.
        torque[1:-1] -= np.diff(torque, 2, axis=0) / 24.0
        force, away = np.zeros_like(torque), np.zeros_like(torque)
        with self._running() as run:
            zero = run.read(self.outputs) - position[0]  # it starts where it starts: only differences count
            slide, apart = velocity[0], [np.zeros(len(self.inputs))] * 3
            for k in range(torque.shape[0] - 1):
                force[k] = stiffness * away[k] + damping * slide
                run.step(torque[k] + force[k], k * step, step)
                away[k + 1] = position[k + 1] + zero - run.read(self.outputs)
                if self.velocities:
                    slide = velocity[k + 1] - run.read(self.velocities)
                else:
                    # A difference is the velocity of half a step ago: by three of them. Of what lies apart:
                    # of the motion itself their error of (ωh)² would be torque.
                    apart = [(away[k + 1] - away[k]) / step, *apart[:2]]
                    slide = (11.0 * apart[0] - 7.0 * apart[1] + 2.0 * apart[2]) / 6.0
        force[1:] = 0.5 * (force[1:] + force[:-1])  # held over a step, it acts half a step later
        return force[::every], (position - away)[::every]

    def _steps_of(self, interval: float) -> int:
        """Fixed steps of the FMU in a sample of the record."""
        count = interval / self.step
        if abs(count - round(count)) > 1e-6 * count or count < 0.5:
            raise InputError(
                f"{self.path}: takes steps of {self.step:g} s alone, and the recording has a sample "
                f"each {interval:.6g} s, no whole number of them; export it with a variable step or one that "
                "fits"
            )
        return round(count)

    def _inertia(self) -> Float64:
        """(M,) inertia of each motor in a first short moment: torque over acceleration."""
        out = np.zeros(len(self.inputs))
        tried = 10 * self.step or TRIED
        for i in range(out.size):
            with self._running() as run:
                before = run.read(self.outputs)[i]
                torque = np.zeros(out.size)
                torque[i] = 1.0
                for k in range(10):
                    run.step(torque, k * tried / 10, tried / 10)
                out[i] = tried**2 / (2.0 * (run.read(self.outputs)[i] - before))
        if not (np.isfinite(out) & (out > 0.0)).all():
            raise InputError(
                f"{self.path}: its positions do not follow its torques: {out.tolist()} kg·m² or kg"
            )
        return out

    @contextmanager
    def _running(self) -> Iterator[_Instance]:
        """An instance between set-up and end."""
        slave: Any = instantiate_fmu(self.folder, self.description, "CoSimulation")
        if self.description.fmiVersion.startswith("2"):
            slave.setupExperiment(startTime=0.0)
        left = apply_start_values(slave, self.description, self.values, settable_in_instantiated)
        slave.enterInitializationMode()
        apply_start_values(slave, self.description, left, settable_in_initialization_mode)
        slave.exitInitializationMode()
        yield _Instance(self, slave)
        with suppress(Exception):  # what it did is read; an end that fails changes nothing
            slave.terminate()
            slave.freeInstance()


@dataclass(frozen=True, eq=False)
class _Instance:
    """An FMU that runs."""

    of: _Fmu
    slave: Any

    @cached_property
    def _is_two(self) -> bool:
        return bool(self.of.description.fmiVersion.startswith("2"))

    def read(self, channels: list[_Channel]) -> Float64:
        """Values of outputs [SI]."""
        read = self.slave.getReal if self._is_two else self.slave.getFloat64
        values = np.array(read([c.reference for c in channels]), dtype=float)
        return np.asarray(values * np.array([c.factor for c in channels]))

    def step(self, torque: Float64, now: float, step: float) -> None:
        """One communication step with the torques held over it."""
        write = self.slave.setReal if self._is_two else self.slave.setFloat64
        torques = [float(t) / c.factor for t, c in zip(torque, self.of.inputs, strict=True)]
        write([c.reference for c in self.of.inputs], torques)
        self.slave.doStep(currentCommunicationPoint=now, communicationStepSize=step)


def opened(path: Path, axes: tuple[str, ...]) -> FmuSimulator:
    """The simulator."""
    return FmuSimulator(path, axes)
