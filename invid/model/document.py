"""The identified model: chains with uncertainties, effects, warnings; JSON by the contract.

In memory a ``Model`` holds a ``CoupledChains`` with a standard deviation for every parameter (NaN
inside arrays, ``null`` in JSON, where the data cannot tell, and then ``warnings`` says what would)
and the effects that extend the linear model.
"""

from __future__ import annotations

import contextlib
import csv
import io
import json
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from invid.disk import not_written
from invid.errors import InputError, ModelError
from invid.model.chains import CoupledChains
from invid.model.doubts import Doubt, doubt_facts, doubts_of
from invid.model.law_table import LawTable, table_from_json, table_to_json
from invid.numerics.arrays import Float64, frozen_float
from invid.wording.sentence import as_sentences, mapped, with_wording

FORMAT = "invid-model"
FORMAT_VERSION = 1
MISSED = 0.5
"""Share of the torque from which a model that misses it is not to be trusted (contract)."""


@dataclass(frozen=True)
class Estimate:
    """A value with one standard deviation and its unit.

    ``std`` is ``None`` where the data cannot tell, 0 where the value was chosen and not fitted.

    ``name`` only where the value is the number of something that has a name: the ``parameter`` of
    ``parameter_drift`` ("A1.spring.2"; its value is 2).
    """

    value: float
    std: float | None = None
    unit: str | None = None
    name: str | None = None


@dataclass(frozen=True)
class EffectTerm:
    """One effect of the catalogue, at its place, with its parameters.

    ``element`` is "mass q" or "spring s" (counted from the motor, from 1), or ``None`` where the
    cause has no such place (``torque_delay``, say). ``other_axis`` only for ``coupling_stiffness``,
    ``table`` only for ``empirical_law``.
    """

    cause: str
    axis: str
    parameters: Mapping[str, Estimate]
    element: str | None = None
    other_axis: str | None = None
    table: LawTable | None = None

    def value(self, name: str) -> float:
        """Value of one parameter; ModelError where the term has none of that name."""
        try:
            return self.parameters[name].value
        except KeyError:
            raise ModelError(
                f"effect {self.cause} on {self.axis}: parameter {name!r} is missing; "
                f"found {sorted(self.parameters)}"
            ) from None


@dataclass(frozen=True, eq=False)
class ChainStd:
    """Standard deviations in the shapes of a ``CoupledChains``; NaN where the data cannot tell."""

    masses: tuple[Float64, ...]
    springs: tuple[Float64, ...]
    dampers: tuple[Float64, ...]
    couplings: Float64
    ground_springs: Float64

    @classmethod
    def unknown(cls, chains: CoupledChains) -> ChainStd:
        """All NaN."""
        return std_by_name(chains, {})


@dataclass(frozen=True, eq=False)
class Model:
    """A model like any other: simulates, saves, loads, is compared, starts the next identification.

    Attributes
    ----------
    covariance, parameter_names
        (n, n) joint covariance of ``parameter_names`` (as made by ``parameter_vector``), where the
        method gives one; used by ``compare`` and by the service's ``changes``.
    fit
        Free-form facts of the fit: chi2, dof, iterations, band_hz, time_offset_s, …
    """

    robot: str
    method: str
    chains: CoupledChains
    std: ChainStd
    linear: bool = False
    effects: tuple[EffectTerm, ...] = ()
    warnings: tuple[str, ...] = ()
    covariance: Float64 | None = None
    parameter_names: tuple[str, ...] = ()
    fit: Mapping[str, Any] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)
    attributes: Mapping[str, Any] = field(default_factory=dict)

    @property
    def axes(self) -> tuple[str, ...]:
        """Axis names."""
        return self.chains.axes

    def extended(self, *effects: EffectTerm) -> Model:
        """The same model with further effects."""
        return replace(self, effects=self.effects + effects)

    def distrusted(self, doubt: Doubt) -> Model:
        """The same model with a reason why it is not to be trusted."""
        return replace(self, fit={**self.fit, **doubt_facts((*doubts_of(self.fit), doubt))})

    def save(self, path: str | Path) -> None:
        """Write the ``invid-model`` file; InputError where that cannot be."""
        save_model(self, Path(path))


class LinearParameter(NamedTuple):
    """A mass, spring, damper, spring to ground or coupling of a model; ``std`` NaN where it is not known."""

    axes: tuple[str, ...]
    """Its axis, or the two that a coupling joins."""
    kind: str
    """"mass", "spring", "damper", "ground_spring" or "coupling"."""
    number: int
    """From the motor, from 1; 0 for kinds of which an axis has one."""
    value: float
    std: float
    unit: str

    @property
    def name(self) -> str:
        """As ``parameter_vector`` has it."""
        return _name(self.axes, self.kind, self.number)


_UNIT_OF = {"spring": "stiffness", "ground_spring": "stiffness", "damper": "damping"}


def linear_parameters(model: Model) -> list[LinearParameter]:
    """All linear parameters in the order of ``parameter_vector``."""
    unit = units(model.linear)
    return [
        LinearParameter(axes, kind, number, value, std, unit[_UNIT_OF.get(kind, "mass")])
        for (axes, kind, number, value), (*_, std) in zip(
            _walk(model.axes, model.chains), _walk(model.axes, model.std), strict=True
        )
        if value != 0 or kind != "ground_spring"
    ]


def parameter_vector(chains: CoupledChains) -> tuple[tuple[str, ...], Float64]:
    """Names and values of all linear parameters, in one fixed order.

    Names read ``A1.mass.1``, ``A1.spring.1``, ``A1.damper.1``, ``A1.ground_spring`` (only where not
    zero), ``A1-A2.coupling``.
    """
    found = [p for p in _walk(chains.axes, chains) if p[3] != 0 or p[1] != "ground_spring"]
    return tuple(_name(*p[:3]) for p in found), np.array([p[3] for p in found])


def with_parameters(chains: CoupledChains, values: Mapping[str, float]) -> CoupledChains:
    """The chains with numbers by the names of ``parameter_vector`` in the place of their own.

    Raises
    ------
    ModelError
        Numbers that no machine has.
    """
    own = numbers_by_name(chains.axes, chains) | dict(values)

    def column(kind: str, like: tuple[Float64, ...]) -> list[list[float]]:
        return [
            [own[_name((axis,), kind, q + 1)] for q in range(part.size)]
            for axis, part in zip(chains.axes, like, strict=True)
        ]

    couplings = np.zeros(chains.couplings.shape)
    for (i, a), (j, b) in combinations(enumerate(chains.axes), 2):
        couplings[i, j] = couplings[j, i] = own[_name((a, b), "coupling", 0)]
    return CoupledChains.build(
        column("mass", chains.masses),
        column("spring", chains.springs),
        column("damper", chains.dampers),
        couplings,
        ground_springs=[own[_name((a,), "ground_spring", 0)] for a in chains.axes],
        axes=chains.axes,
    )


def numbers_by_name(axes: Sequence[str], numbers: CoupledChains | ChainStd) -> dict[str, float]:
    """Numbers by the names of ``parameter_vector``; a coupling under both orders of its axes."""
    out: dict[str, float] = {}
    for names, kind, number, value in _walk(axes, numbers):
        out[_name(names, kind, number)] = out[_name(names[::-1], kind, number)] = value
    return out


def stds_by_name(model: Model) -> dict[str, float]:
    """Standard deviations by name (``numbers_by_name``)."""
    return numbers_by_name(model.axes, model.std)


def _name(axes: tuple[str, ...], kind: str, number: int) -> str:
    return f"{'-'.join(axes)}.{kind}" + (f".{number}" if number else "")


def _walk(
    axes: Sequence[str], numbers: CoupledChains | ChainStd
) -> Iterator[tuple[tuple[str, ...], str, int, float]]:
    """Axes, kind, number and value of every linear parameter, springs to ground of all axes among them."""
    for i, axis in enumerate(axes):
        for kind, column in (
            ("mass", numbers.masses),
            ("spring", numbers.springs),
            ("damper", numbers.dampers),
        ):
            for q, value in enumerate(column[i], 1):
                yield (axis,), kind, q, float(value)
        yield (axis,), "ground_spring", 0, float(numbers.ground_springs[i])
    for i, j in combinations(range(len(axes)), 2):
        yield (axes[i], axes[j]), "coupling", 0, float(numbers.couplings[i, j])


def units(linear: bool) -> dict[str, str]:
    """Units of the model's parameters by kind."""
    if linear:
        return {"mass": "kg", "stiffness": "N/m", "damping": "N·s/m"}
    return {"mass": "kg·m²", "stiffness": "N·m/rad", "damping": "N·m·s/rad"}


# --- the JSON contract -----------------------------------------------------------------------------
class _Open(BaseModel):
    """Keys added by later versions are ignored here, kept in ``Model.attributes`` at the top level."""

    model_config = ConfigDict(extra="allow", allow_inf_nan=False)


class _EstimateJson(_Open):
    value: float
    std: float | None = None
    unit: str | None = None


class _BranchJson(_Open):
    axis: str
    masses: list[_EstimateJson] = Field(min_length=1)
    springs: list[_EstimateJson] = []
    dampers: list[_EstimateJson] = []
    ground_spring: _EstimateJson | None = None


class _CouplingJson(_Open):
    between: tuple[str, str]
    value: float
    std: float | None = None


class _NamedJson(_EstimateJson):
    value: float | str  # type: ignore[assignment]
    name: str | None = None


class _EffectJson(_Open):
    cause: str
    axis: str
    element: str | None = None
    other_axis: str | None = None
    parameters: dict[str, _NamedJson | float | str | dict[str, Any]] = {}


class _CovarianceJson(_Open):
    names: list[str]
    matrix: list[list[float]]


class _ModelJson(_Open):
    format: Literal["invid-model"]
    format_version: Literal[1]
    robot: str = ""
    method: str = ""
    units: dict[str, str] = {}
    branches: list[_BranchJson] = Field(min_length=1)
    couplings: list[_CouplingJson] = []
    effects: list[_EffectJson] = []
    warnings: list[str] = []
    fit: dict[str, Any] = {}
    provenance: dict[str, Any] = {}
    covariance: _CovarianceJson | None = None


def finite_or_none(value: float) -> float | None:
    """A number as JSON has it: ``None`` where it is none."""
    return float(value) if math.isfinite(value) else None


def with_numbers(value: Any, number: Callable[[float], float | None] = finite_or_none) -> Any:
    """Plain dicts and lists of a document, every number as ``number`` has it."""
    return mapped(value, lambda leaf: number(leaf) if isinstance(leaf, float) else leaf)


def _estimate(value: float, std: float) -> dict[str, Any]:
    return {"value": float(value), "std": finite_or_none(float(std))}


def effect_to_json(term: EffectTerm) -> dict[str, Any]:
    """One effect as in the contract."""
    return {
        "cause": term.cause,
        "axis": term.axis,
        "element": term.element,
        "other_axis": term.other_axis,
        "parameters": {
            name: {
                "value": p.value,
                "std": None if p.std is None else finite_or_none(p.std),
                "unit": p.unit,
                **({} if p.name is None else {"name": p.name}),
            }
            for name, p in term.parameters.items()
        }
        | ({} if term.table is None else table_to_json(term.table)),
    }


def model_to_json(model: Model) -> dict[str, Any]:
    """The contract's ``invid-model`` document."""
    chains, std = model.chains, model.std
    branches = []
    for i, axis in enumerate(chains.axes):
        branch: dict[str, Any] = {"axis": axis}
        for kind in ("masses", "springs", "dampers"):
            values = zip(getattr(chains, kind)[i], getattr(std, kind)[i], strict=True)
            branch[kind] = [_estimate(v, s) for v, s in values]
        if chains.ground_springs[i] != 0:
            branch["ground_spring"] = _estimate(chains.ground_springs[i], std.ground_springs[i])
        branches.append(branch)
    couplings = [
        {"between": [a, b], **_estimate(chains.couplings[i, j], std.couplings[i, j])}
        for (i, a), (j, b) in combinations(enumerate(chains.axes), 2)
    ]
    document: dict[str, Any] = {
        **model.attributes,
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "robot": model.robot,
        "method": model.method,
        "units": units(model.linear),
        "branches": branches,
        "couplings": couplings,
        "effects": [effect_to_json(e) for e in model.effects],
        "warnings": list(model.warnings),
        "fit": dict(model.fit),
        "provenance": dict(model.provenance),
    }
    if model.covariance is not None:
        document["covariance"] = {
            "names": list(model.parameter_names),
            "matrix": np.asarray(model.covariance).tolist(),
        }
    return document


def describe_validation_error(error: ValidationError, where: str) -> str:
    """First problem of a pydantic error as one sentence: where, what, the value found."""
    first = error.errors(include_url=False)[0]
    path = ".".join(str(part) for part in first["loc"]) or "document"
    found = first.get("input")
    shown = repr(found)
    if len(shown) > 80:
        shown = shown[:77] + "…"
    more = f" (and {error.error_count() - 1} more)" if error.error_count() > 1 else ""
    return f"{where}: {path}: {first['msg']}; found {shown}{more}"


_NAMED = re.compile(r"(?:(?P<axis>.+)\.)?(?P<kind>mass|spring)[ .]?(?P<number>[1-9]\d*)")


def effect_from_json(document: Any, *, source: str = "effect") -> EffectTerm:
    """One effect as in the contract; ModelError says what is wrong."""
    try:
        return _effect_term(_EffectJson.model_validate(document), source)
    except ValidationError as error:
        raise ModelError(describe_validation_error(error, source)) from None


def _effect_term(e: _EffectJson, source: str) -> EffectTerm:
    """One effect; a parameter called by its name ("A1.spring.2", "spring 2") is its number and its place."""
    element, parameters, where = e.element, {}, f"{source}: effect {e.cause} on {e.axis}"
    table = None
    if "table" in e.parameters:
        said = {k: p.model_dump() if isinstance(p, _NamedJson) else p for k, p in e.parameters.items()}
        table = table_from_json(said, where)
    for key, p in e.parameters.items():
        if table is not None and key in ("over", "across", "table"):
            continue
        if isinstance(p, dict):
            raise ModelError(f"{where}: {key} is {p!r:.60}; it must be a number")
        given = p if isinstance(p, _NamedJson) else _NamedJson(value=p)
        name = given.value if isinstance(given.value, str) else given.name
        if not isinstance(given.value, str):
            parameters[key] = Estimate(given.value, given.std, given.unit, name)
            continue
        found = _NAMED.fullmatch(given.value)
        if key != "parameter" or found is None or found["axis"] not in (None, e.axis):
            raise ModelError(
                f"{source}: effect {e.cause} on {e.axis}: {key} is {given.value!r}; "
                + (
                    f"name a parameter of the axis, as {e.axis}.spring.1 or {e.axis}.mass.1"
                    if key == "parameter"
                    else "it must be a number"
                )
            )
        place = f"{found['kind']} {found['number']}"
        if element not in (None, place):
            raise ModelError(
                f"{source}: effect {e.cause} on {e.axis}: element {element!r}, but parameter {given.value!r}"
            )
        element = place
        parameters[key] = Estimate(float(found["number"]), 0.0, given.unit, name)
    return EffectTerm(e.cause, e.axis, parameters, element, e.other_axis, table)


def model_from_json(document: Any, *, source: str = "model") -> Model:
    """Model from a parsed ``invid-model`` document; ModelError says what is wrong and where."""
    try:
        parsed = _ModelJson.model_validate(document)
    except ValidationError as error:
        raise ModelError(describe_validation_error(error, source)) from None
    axes = [b.axis for b in parsed.branches]
    index = {a: i for i, a in enumerate(axes)}
    count = len(axes)
    couplings, coupling_std = np.zeros((count, count)), np.full((count, count), np.nan)
    for c in parsed.couplings:
        try:
            i, j = index[c.between[0]], index[c.between[1]]
        except KeyError as missing:
            raise ModelError(f"{source}: coupling between {list(c.between)}: no branch {missing}") from None
        if i == j:
            raise ModelError(f"{source}: coupling between {list(c.between)}: the two axes must differ")
        couplings[i, j] = couplings[j, i] = c.value
        coupling_std[i, j] = coupling_std[j, i] = np.nan if c.std is None else c.std

    def stds(items: Sequence[_EstimateJson | None]) -> Float64:
        return frozen_float([np.nan if e is None or e.std is None else e.std for e in items])

    try:
        chains = CoupledChains.build(
            [[e.value for e in b.masses] for b in parsed.branches],
            [[e.value for e in b.springs] for b in parsed.branches],
            [[e.value for e in b.dampers] if b.dampers else [0.0] * len(b.springs) for b in parsed.branches],
            couplings,
            ground_springs=[b.ground_spring.value if b.ground_spring else 0.0 for b in parsed.branches],
            axes=axes,
        )
    except ModelError as error:
        raise ModelError(f"{source}: {error}") from None
    std = ChainStd(
        masses=tuple(stds(b.masses) for b in parsed.branches),
        springs=tuple(stds(b.springs) for b in parsed.branches),
        dampers=tuple(stds(b.dampers or [None] * len(b.springs)) for b in parsed.branches),
        couplings=frozen_float(coupling_std),
        ground_springs=stds([b.ground_spring for b in parsed.branches]),
    )
    effects = tuple(_effect_term(e, source) for e in parsed.effects)
    for e in effects:
        if e.axis not in index:
            raise ModelError(f"{source}: effect {e.cause}: no branch called {e.axis!r}; found {axes}")
    return Model(
        robot=parsed.robot,
        method=parsed.method,
        chains=chains,
        std=std,
        linear=parsed.units.get("mass") == "kg",
        effects=effects,
        warnings=tuple(parsed.warnings),
        covariance=None if parsed.covariance is None else frozen_float(parsed.covariance.matrix),
        parameter_names=() if parsed.covariance is None else tuple(parsed.covariance.names),
        fit=parsed.fit,
        provenance=parsed.provenance,
        attributes=dict(parsed.model_extra or {}),
    )


def dump_json(document: Mapping[str, Any]) -> str:
    """Strict JSON text (no NaN), UTF-8, indented; keys in the order given, then ``wording``, what other
    languages need to say the sentences in it.
    """
    return json.dumps(with_wording(document), ensure_ascii=False, indent=2, allow_nan=False) + "\n"


def parse_json(text: str) -> Any:
    """The document of a text, with its sentences; JSONDecodeError, RecursionError where it is none."""
    return as_sentences(json.loads(text))


def csv_text(head: Iterable[str], rows: Iterable[Iterable[object]]) -> str:
    """A table as text; numbers to nine digits, nothing for those that are none."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(head)
    for row in rows:
        shown = [("" if math.isinf(x) else f"{x:.9g}") if isinstance(x, float) else x for x in row]
        writer.writerow(shown)
    return stream.getvalue()


def load_json(path: Path) -> Any:
    """Parsed JSON file; InputError says what is wrong with the file."""
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: {_binary_kind(path)}, no JSON document") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error}") from None
    try:
        return parse_json(text)
    except (json.JSONDecodeError, RecursionError) as error:
        raise InputError(f"{path}: not JSON: {error}") from None


def _binary_kind(path: Path) -> str:
    with path.open("rb") as file:
        head = file.read(8)
    return "an HDF5 file (a recording?)" if head == b"\x89HDF\r\n\x1a\n" else "binary data"


def save_text(path: Path, text: str) -> None:
    """``save_bytes`` of a text, UTF-8."""
    save_bytes(path, text.encode())


def save_bytes(path: Path, content: bytes) -> None:
    """Write to a temporary name beside ``path``, then rename: a crash or a full disk leaves the old file
    whole.
    """
    temporary = path.with_name(path.name + ".part")
    try:
        if path.exists() and not path.is_file():  # /dev/stdout stays what it is
            path.write_bytes(content)
            return
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary.write_bytes(content)
        temporary.replace(path)
    except OSError as error:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
        raise not_written(path, error) from None


def save_model(model: Model, path: Path) -> None:
    """Write the ``invid-model`` file."""
    save_text(path, dump_json(model_to_json(model)))


def std_by_name(chains: CoupledChains, std: Mapping[str, float]) -> ChainStd:
    """Standard deviations in the shapes of ``chains``; NaN for names that ``std`` does not have."""

    def column(kind: str, parts: tuple[Float64, ...]) -> tuple[Float64, ...]:
        return tuple(
            frozen_float([std.get(f"{axis}.{kind}.{q + 1}", np.nan) for q in range(part.size)])
            for axis, part in zip(chains.axes, parts, strict=True)
        )

    couplings = np.full((chains.branches, chains.branches), np.nan)
    for (i, a), (j, b) in combinations(enumerate(chains.axes), 2):
        couplings[i, j] = couplings[j, i] = std.get(f"{a}-{b}.coupling", np.nan)
    return ChainStd(
        masses=column("mass", chains.masses),
        springs=column("spring", chains.springs),
        dampers=column("damper", chains.dampers),
        couplings=frozen_float(couplings),
        ground_springs=frozen_float([std.get(f"{a}.ground_spring", np.nan) for a in chains.axes]),
    )
