"""YAML file to ``CellConfig``; every error names file, line, field, value and the way out."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, get_args

import yaml
from pydantic import AliasChoices, BaseModel, ValidationError
from pydantic.fields import FieldInfo

from invid.config.schema import CellConfig
from invid.errors import ConfigError

MAX_BYTES = 1_000_000
"""A cell of 32 axes with every key is below 100 kB; a larger file is no config."""
MAX_VALUES = 100_000
"""Aliases expand; this many values end a YAML bomb before it fills the memory."""

Where = tuple[str | int, ...]

# Units in a key that belong to one kind of motion only.
_ROTARY = ("_rad", "_Nm", "_Nms", "_kgm2")
_LINEAR = ("_N", "_m", "_Ns", "_kg")
_UNIT = re.compile(r"_(rad|m|Nm|N|Nms|Ns|kgm2|kg|s|Hz|bit)(_per_\w+)?$")


def load_config(path: Path | str) -> CellConfig:
    """The config in a YAML file.

    Raises
    ------
    ConfigError
        File missing, too large, no YAML, or a value that cannot be used; says file, line and field.
    """
    path = Path(path)
    try:
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise ConfigError(
                f"{path}: {size} bytes is too large for a config (at most {MAX_BYTES}); is it a recording?"
            )
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise ConfigError(
            f"{path}: no such file; `invid init -o {path}` writes a first config from the bus"
        ) from None
    except IsADirectoryError:
        raise ConfigError(f"{path}: is a folder; name the YAML file in it") from None
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: not a text file ({error.reason} at byte {error.start})") from None
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from None
    return _beside(parse_config(text, source=str(path)), path.parent)


def _beside(config: CellConfig, folder: Path) -> CellConfig:
    """Return the config with its EDS files as paths: they stand beside it, wherever the command runs."""
    if all(a.eds is None for a in config.axes):
        return config
    axes = [a if a.eds is None else a.model_copy(update={"eds": str(folder / a.eds)}) for a in config.axes]
    return config.model_copy(update={"axes": axes})


def parse_config(text: str, *, source: str = "config") -> CellConfig:
    """The config in a YAML text; ``source`` stands in messages."""
    data, lines = load_yaml(text, source)
    if not isinstance(data, Mapping):
        found = "nothing" if data is None else type(data).__name__
        raise ConfigError(
            f"{source}: a config is a mapping that opens with 'format: invid-config', found {found}"
        )
    if data.get("format") != "invid-config":
        raise ConfigError(
            f"{_at(source, lines, ('format',))}: format is {data.get('format')!r}; "
            "a cell's config says 'format: invid-config'"
        )
    _refuse_other_units(data, source, lines)
    try:
        return CellConfig.model_validate(data)
    except ValidationError as error:
        raise ConfigError(explain_errors(error, source, lines, "config", CellConfig)) from None


def load_yaml(text: str, source: str) -> tuple[Any, dict[Where, int]]:
    """Plain data and the line of every key and item."""
    lines: dict[Where, int] = {}
    try:
        loader = yaml.SafeLoader(text)
    except yaml.YAMLError as error:
        raise ConfigError(f"{source}: not YAML: {str(error).splitlines()[0]}") from None
    budget = [MAX_VALUES]

    def build(node: yaml.Node, where: Where, open_nodes: tuple[int, ...]) -> Any:
        budget[0] -= 1
        if budget[0] < 0:
            raise ConfigError(
                f"{source}: more than {MAX_VALUES} values once its aliases (references, *name) are expanded"
            )
        if id(node) in open_nodes:
            raise ConfigError(
                f"{source}:{node.start_mark.line + 1}: an alias contains itself: write its references "
                f"(*name) out"
            )
        inner = (*open_nodes, id(node))
        if isinstance(node, yaml.MappingNode):
            result: dict[Any, Any] = {}
            for key_node, value_node in node.value:
                line = key_node.start_mark.line + 1
                if not isinstance(key_node, yaml.ScalarNode):
                    raise ConfigError(f"{source}:{line}: a key must be a plain name")
                key = loader.construct_object(key_node, deep=True)
                if key in result:
                    raise ConfigError(f"{source}:{line}: key {key!r} stands twice; keep one")
                lines[(*where, key)] = line
                result[key] = build(value_node, (*where, key), inner)
            return result
        if isinstance(node, yaml.SequenceNode):
            items = []
            for i, item in enumerate(node.value):
                lines[(*where, i)] = item.start_mark.line + 1
                items.append(build(item, (*where, i), inner))
            return items
        return loader.construct_object(node, deep=True)

    try:
        root = loader.get_single_node()
        return (None if root is None else build(root, (), ())), lines
    except ConfigError:
        raise
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = f":{mark.line + 1}" if mark is not None else ""
        raise ConfigError(f"{source}{line}: not YAML: {error.problem or error.context}") from None
    except (yaml.YAMLError, ValueError, RecursionError, TypeError) as error:
        raise ConfigError(f"{source}: not YAML: {str(error).splitlines()[0]}") from None
    finally:
        loader.dispose()


def _at(source: str, lines: dict[Where, int], where: Where) -> str:
    """``file:line`` of the place, or of the nearest one around it that has a line."""
    for length in range(len(where), 0, -1):
        line = lines.get(where[:length])
        if line is not None:
            return f"{source}:{line}"
    return source


def _field(where: Where) -> str:
    text = ""
    for part in where:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else str(part)
    return text or "config"


def _in_file(loc: tuple[str | int, ...], lines: dict[Where, int]) -> Where:
    """A pydantic location without the tags of unions, which stand in no file."""
    where: Where = ()
    for i, part in enumerate(loc):
        known = (*where, part) in lines
        if known or i == len(loc) - 1 or isinstance(part, int):
            where = (*where, part)
        elif where and isinstance(where[-1], int):
            continue
        else:
            where = (*where, part)
    return where


def explain_errors(
    error: ValidationError, source: str, lines: dict[Where, int], what: str, model: type[BaseModel]
) -> str:
    """The first five problems of a document (``what``: config, map), which is to be a ``model``: file, line,
    field, value."""
    sentences, missing = [], dict[Where, str]()
    for item in error.errors():
        where = _in_file(item["loc"], lines)
        message = str(item["msg"]).removeprefix("Value error, ").replace("Input should be", "it must be")
        place, fields = _at(source, lines, where), _fields_at(model, where[:-1])
        if item["type"] == "extra_forbidden":
            meant = _meant(str(where[-1]), fields)
            missing.pop((*where[:-1], meant[0]) if meant else (), None)
            unit = ", the value in that unit" if meant and _UNIT.search(meant[-1]) else ""
            known = f"write {_key_of(meant)}{unit}" if meant else ""
            advice = known or "check its spelling, its place and its unit"
            value = _short(item["input"])
            sentences.append(f"{place}: {_field(where)} is no key of a {what} here (value {value}); {advice}")
        elif item["type"] == "missing":
            keys = next((k for k in fields if k[0] == where[-1]), (str(where[-1]),))
            missing[where] = f"{place}: {_field((*where[:-1], _key_of(keys)))} is missing; add it"
        elif item["type"] == "value_error":
            sentences.append(f"{place}: {_field(where)}: {message}")
        else:
            sentences.append(f"{place}: {_field(where)} is {_short(item['input'])}: {message}")
    sentences = [*missing.values(), *sentences]
    more = len(sentences) - 5
    return "\n".join(sentences[:5]) + (f"\n… and {more} more" if more > 0 else "")


def _keys(name: str, field: FieldInfo) -> tuple[str, ...]:
    """A field's name, and the keys that say it with its unit: of rotary motion, then of linear."""
    alias = field.validation_alias
    return tuple(map(str, alias.choices)) if isinstance(alias, AliasChoices) else (name,)


def _fields_at(model: type[BaseModel], where: Where) -> list[tuple[str, ...]]:
    """The keys of every field that may stand at a place of the document."""
    models = [model]
    for part in where:
        if isinstance(part, str):
            fields = [(_keys(n, f), f) for m in models for n, f in m.model_fields.items()]
            models = [m for keys, f in fields if part in keys for m in _models_in(f.annotation)]
    return [_keys(n, f) for m in models for n, f in m.model_fields.items()]


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [m for inner in get_args(annotation) for m in _models_in(inner)]


def _meant(found: str, fields: Sequence[tuple[str, ...]]) -> tuple[str, ...] | None:
    """The field whose name, or key without its unit, is the beginning of a key that is none."""
    fits = [
        (len(stem), keys)
        for keys in fields
        for stem in {keys[0], *(_UNIT.sub("", k) for k in keys)}
        if f"{found}_".lower().startswith(f"{stem}_".lower())
    ]
    return max(fits)[1] if fits else None


def _key_of(keys: tuple[str, ...]) -> str:
    """How a config names a field: "torque_Nm (force_N where motion is linear)"."""
    rotary, *linear = keys[1:] or keys
    return rotary + "".join(f" ({k} where motion is linear)" for k in linear)


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "…"


def _refuse_other_units(data: Mapping[Any, Any], source: str, lines: dict[Where, int]) -> None:
    """Refuse a key in metres on a rotary axis, or the reverse: a mistake of a factor nobody knows."""
    motion = data.get("motion", "rotary")
    wrong = {"rotary": _LINEAR, "linear": _ROTARY}.get(motion if isinstance(motion, str) else "")
    if wrong is None:
        return

    def walk(value: Any, where: Where) -> None:
        if isinstance(value, Mapping):
            for key, inner in value.items():
                place = (*where, key)
                if isinstance(key, str) and any(
                    key.endswith((u, f"_per{u}")) or f"{u}_per_" in key for u in wrong
                ):
                    raise ConfigError(
                        f"{_at(source, lines, place)}: {_field(place)} is given in the units of "
                        f"{'linear' if motion == 'rotary' else 'rotary'} motion, but motion is {motion!r}; "
                        "use the key with this motion's unit or change motion"
                    )
                walk(inner, place)
        elif isinstance(value, list):
            for i, inner in enumerate(value):
                walk(inner, (*where, i))

    for section in ("axes", "experiments"):
        walk(data.get(section), (section,))
