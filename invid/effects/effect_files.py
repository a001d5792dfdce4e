"""Effects of files and installed packages: read, and checked whole before anything is measured with them.

Each error names the file, the line, what was found and what is allowed there.
"""

from __future__ import annotations

import ast
import difflib
import hashlib
import importlib.util
import inspect
import sys
import textwrap
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NoReturn

import numpy as np

from invid.effects.effect import FAMILIES, HOMES, OVER, Effect, Experiment, PlaceMotion
from invid.effects.motion_effect import OF_MOTION, PAIRS, MotionEffect
from invid.effects.sizes import Size
from invid.effects.units import unit_of
from invid.errors import InputError
from invid.extensions import error_text, load_extensions
from invid.model.place import Place
from invid.model.plant import Structure

GROUP = "invid.effects"
"""Entry point group of installed packages."""
_PLACES = "write def places(self, structure): return mass_places(structure), or motor_places, end_places, " \
    "spring_places, axis_places"  # fmt: skip


def load_effects(path: Path) -> tuple[Effect, ...]:
    """The effects of a Python file (``EFFECT`` or ``EFFECTS``); InputError says what is wrong and where."""
    where = f"effects file {path}"
    try:
        source = path.read_bytes()
    except OSError as error:
        raise InputError(f"{where}: cannot be read: {error.strerror}") from None
    key = hashlib.sha256(str(path.resolve()).encode() + b"\0" + source).hexdigest()[:16]
    name = f"invid_effects_{key}"  # as what is pickled between helpers names it
    module = sys.modules.get(name)
    if module is None:
        spec = importlib.util.spec_from_file_location(name, path)
        if spec is None or spec.loader is None:
            raise InputError(f"{where}: is no Python file; its name has to end in .py")
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module
        try:
            spec.loader.exec_module(module)
        except Exception as error:  # whatever a stranger's file raises
            del sys.modules[name]
            raise InputError(f"{where}{_line_in(path, error)}: {error_text(error)}") from None
    held = getattr(module, "EFFECTS", None) or getattr(module, "EFFECT", None)
    return tuple(check_effect(e, where) for e in _effects_held(held, where))


def installed_effects() -> list[Effect]:
    """The effects of installed packages; InputError names one that cannot be used."""
    found: list[Effect] = []
    for where, held in load_extensions(GROUP):
        found += [check_effect(e, where) for e in _effects_held(held, where)]
    return found


def _line_in(path: Path | str, error: Exception) -> str:
    """ ", line 7": where in the file an exception came from; "" where it did not come from there."""
    if isinstance(error, SyntaxError):
        return f", line {error.lineno}" if error.filename == str(path) else ""
    lines = [f.lineno for f in traceback.extract_tb(error.__traceback__) if f.filename == str(path)]
    return f", line {lines[-1]}" if lines else ""


def _effects_held(held: object, where: str) -> Sequence[object]:
    if held is None:
        raise InputError(f"{where}: holds no EFFECT; write EFFECT = YourEffect() at its end")
    return held if isinstance(held, list | tuple) else (held,)


def check_effect(effect: object, where: str) -> Effect:
    """The effect itself; InputError where anything that it declares cannot be used."""
    if isinstance(effect, type) and issubclass(effect, Effect):
        raise InputError(
            f"{where}: EFFECT is the class {effect.__name__}; write EFFECT = {effect.__name__}()"
        )
    if not isinstance(effect, Effect):
        raise InputError(f"{where}: EFFECT is {type(effect).__name__}, no invid.effects.Effect")

    def refuse(name: str, what: str) -> NoReturn:
        raise InputError(f"{where}{_line_of(type(effect), name)}: {type(effect).__name__}: {what}")

    _check_names(effect, refuse)
    _check_words(effect, refuse)
    _check_parameters(effect, refuse)
    _check_methods(effect, where, refuse)
    return effect


Refuse = Callable[[str, str], NoReturn]


def _line_of(kind: type, name: str) -> str:
    """ ", line 7": where a class states a name, else where the class begins; "" where no source is known."""
    owner = next((k for k in kind.__mro__ if name in vars(k) and k.__module__ == kind.__module__), kind)
    try:
        lines, first = inspect.getsourcelines(owner)
        body = ast.parse(textwrap.dedent("".join(lines))).body[0]
    except (OSError, TypeError, SyntaxError, IndexError):
        return ""
    for node in body.body if isinstance(body, ast.ClassDef) else ():
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        stated = {n.id for t in targets if t for n in ast.walk(t) if isinstance(n, ast.Name)}
        if name in stated or getattr(node, "name", None) == name:
            return f", line {first + node.lineno - 1}"
    return f", line {first}"


def _check_names(effect: Effect, refuse: Refuse) -> None:
    """Refuse a name that is nearly one of an effect's: it would be passed over in silence."""
    known = [n for n in dir(MotionEffect if isinstance(effect, MotionEffect) else Effect) if n[0] != "_"]
    for kind in type(effect).__mro__:
        if kind.__module__.startswith("invid.effects"):
            break
        for name in vars(kind):
            near = difflib.get_close_matches(name, known, 1, 0.85)
            if name[0] != "_" and name not in known and near:
                refuse(name, f"an effect has no {name!r}; {near[0]!r} is meant, or call it '_{name}'")


def _check_words(effect: Effect, refuse: Refuse) -> None:
    """Refuse what the effect says of itself where it is no word that invid knows."""
    if not (isinstance(effect.cause, str) and effect.cause.isidentifier()):
        refuse("cause", f"cause is {effect.cause!r}; give it a name as quadratic_drag")
    for name in ("title", "check"):
        if not (isinstance(getattr(effect, name), str) and getattr(effect, name).strip()):
            refuse(name, f"{name} is empty; say it in a few words")
    # Drawn over anything, but a table over quantities of the motion is all that follows from a law.
    table = isinstance(effect, MotionEffect) and type(effect).simulation is MotionEffect.simulation
    for name, allowed in (("family", FAMILIES), ("home", HOMES), ("over", OF_MOTION if table else OVER)):
        found = getattr(effect, name)
        if found not in allowed:
            more = "; a law over another quantity has to give simulation" if name == "over" and table else ""
            refuse(name, f"{name} is {found!r}; it is one of {_listed(allowed)}{more}")
    if table and effect.across and {effect.over, effect.across} not in [set(pair) for pair in PAIRS]:
        refuse("across", f"across is {effect.across!r} beside over {effect.over!r}; the two are "
               f"{' or '.join(' and '.join(map(repr, pair)) for pair in PAIRS)}")  # fmt: skip
    one = effect.separating
    if not isinstance(one, Experiment) or not one.text:
        refuse("separating", "separating is missing; write separating = Experiment(kind, words), kind one of "
               f"{_listed(Experiment.KINDS)}")  # fmt: skip
    for name, kind in (("sizes", Size), ("looks_like", str)):
        found = getattr(effect, name)
        if not isinstance(found, tuple) or not all(isinstance(f, kind) for f in found):
            refuse(name, f"{name} is {found!r}; it is a tuple of {kind.__name__}, one of them as (x,)")


def _listed(allowed: Sequence[str]) -> str:
    return ", ".join(repr(a) for a in allowed)


def _check_parameters(effect: Effect, refuse: Refuse) -> None:
    """Refuse parameters that are none, stand twice, or have no unit."""
    numbers = effect.numbers
    if isinstance(effect, MotionEffect) and not numbers:
        refuse("numbers", "it has no parameters; give numbers = (Parameter(name, unit),)")
    if not effect.parameters:
        refuse("parameters", "it has no parameters; give parameters = {name: unit}")
    for p in numbers if getattr(type(effect), "starts", None) is MotionEffect.starts else ():
        if not p.linear and not p.starts:
            refuse("numbers", f"parameter {p.name!r}: linear=False asks for starts, values to begin from")
    names = [p.name for p in numbers]
    if len(set(names)) < len(names):
        refuse("numbers", f"two parameters have one name: {_listed(names)}")
    if effect.main not in effect.parameters:
        refuse("main", f"{effect.main!r} is no parameter; these are {_listed(tuple(effect.parameters))}")
    for name, unit in effect.parameters.items():
        try:
            unit_of(unit, linear=False)
        except InputError as error:
            refuse("parameters", f"parameter {name!r}: {error}")


def _check_methods(effect: Effect, where: str, refuse: Refuse) -> None:
    """Refuse an effect whose places or law are missing, fail, or return what cannot be used."""
    if type(effect).places is Effect.places and effect.stands is None:
        refuse("places", f"places is missing; {_PLACES}")
    if isinstance(effect, MotionEffect) and type(effect).resistance is MotionEffect.resistance:
        refuse("resistance", "resistance is missing; write def resistance(self, motion, shape): return the "
               "force for each linear parameter at one, (samples, parameters)")  # fmt: skip
    file = getattr(sys.modules.get(type(effect).__module__), "__file__", None) or ""
    doing = "places"
    try:
        structure = Structure((2, 2))
        found = effect.places(structure)
        if not isinstance(found, list | tuple) or not all(isinstance(p, Place) for p in found):
            refuse("places", f"places gives {found!r:.60}; {_PLACES}")
        for place in found:
            place.pattern(structure)
        doing = "a motion of ten samples"
        if isinstance(effect, MotionEffect):
            _try_law(effect, refuse)
    except InputError:
        raise
    except Exception as error:  # whatever a stranger's law raises
        at = _line_in(file, error) or _line_of(type(effect), "resistance")
        raise InputError(f"{where}{at}: {effect.cause}: {error_text(error)} on {doing}") from None


def _try_law(effect: MotionEffect, refuse: Refuse) -> None:
    """Evaluate the law on a motion of ten samples; InputError where the result is not usable."""
    x = np.linspace(-1.0, 1.0, 10)
    out = np.asarray(effect.resistance(PlaceMotion(x, x[::-1].copy(), x), effect.starts(1.0, 1.0)[0]))
    wanted = (10, len(effect.linear))
    if out.shape != wanted or not np.isfinite(out).all():
        shown = f"has shape {out.shape}" if out.shape != wanted else "is not finite"
        refuse("resistance", f"its resistance {shown}; it must be finite, (samples, linear parameters), here "
               f"{wanted}")  # fmt: skip
