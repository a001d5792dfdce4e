"""The one text: a sentence is an English string that carries its template and the values in it.

``sentence("axis {axis}: {torque:.3g} N·m", axis=…, torque=…)`` makes one; ``say`` fills the template of
another language, which ``de.json`` has under the English one. No program reads a sentence.

One JSON file a language, for Python and the page: no text needs a plural form, so gettext's compiled files
would be a build step that buys nothing.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from functools import cache, lru_cache
from pathlib import Path
from string import Formatter
from typing import Any

LANGUAGES = ("en", "de")
"""The first one is that of documents and logs."""
ENGLISH = LANGUAGES[0]


class Figure(str):
    """Numbers with their units, written with decimal points: "+1.31 ± 0.02 kg·m²"."""

    __slots__ = ()

    def __format__(self, spec: str) -> str:
        return str(self)  # it is formatted already


class Sentence(str):
    """An English sentence or a part of one, with what any language needs to say it.

    Attributes
    ----------
    template
        The English words with named gaps, without formats: the key of the catalogues.
    values
        What fills the gaps: names as ``str``, numbers as ``Figure``, parts with words of their own as
        ``Sentence``.
    form
        "capital": it begins with a capital letter; "clause": its first clause alone, to stand behind a colon.
    """

    __slots__ = ("form", "template", "values")
    template: str
    values: Mapping[str, str]
    form: str

    def __new__(cls, template: str, values: Mapping[str, str] | None = None, form: str = "") -> Sentence:
        values = dict(values or {})
        text = _formed(template.format_map(values), form)
        made = super().__new__(cls, lower_first(text) if form == "clause" else text)
        made.template, made.values, made.form = template, values, form
        return made

    def __reduce__(self) -> tuple[Any, ...]:
        return Sentence, (self.template, self.values, self.form)

    def in_words_of(self, language: str) -> str:
        """Return it in a language, else in English."""
        words = catalogue(language).get(self.template, self.template)
        # A German clause may begin with a noun, whose capital stays.
        return _formed(words.format_map({k: say(v, language) for k, v in self.values.items()}), self.form)


def _formed(text: str, form: str) -> str:
    if form == "clause":
        return text.split(";")[0].rstrip(".")
    return f"{text[:1].upper()}{text[1:]}" if form == "capital" else text


def clause(text: str) -> str:
    """Return the first clause of a sentence, to stand behind a colon: without its full stop."""
    return Sentence("{p0}", {"p0": text}, "clause")


def capital(text: str) -> str:
    """Return the text with its first letter a capital."""
    return Sentence("{p0}", {"p0": text}, "capital")


def stated(parts: Sequence[str]) -> str:
    """Return statements as one sentence, joined by semicolons, with its full stop or question mark."""
    if not parts:
        return ""
    whole = joined(parts, "; ")
    return capital(whole if whole.endswith(("?", ".")) else sentence("{whole}.", whole=whole))


def marked(template: str) -> str:
    """Return a template that ``sentence`` gets elsewhere; the catalogues have its words."""
    return template


def sentence(template: str, /, **values: object) -> str:
    """Return a sentence: ``template`` as ``str.format`` takes it, with a value for each named gap."""
    plain, gaps = _parsed(template)
    return Sentence(plain, {name: _value(values[name], spec, how) for name, spec, how in gaps})


@lru_cache(4096)
def _parsed(template: str) -> tuple[str, tuple[tuple[str, str, str | None], ...]]:
    """Return a template without formats, and its gaps: name, format, conversion."""
    plain, gaps = "", []
    for literal, name, spec, how in Formatter().parse(template):
        plain += literal.replace("{", "{{").replace("}", "}}")
        if name is not None:
            plain += f"{{{name}}}"
            gaps.append((name, spec or "", how))
    return plain, tuple(gaps)


def _value(value: object, spec: str, how: str | None) -> str:
    if how == "r":
        return repr(value)
    if isinstance(value, Figure | Sentence):
        return value
    return Figure(format(value, spec)) if spec or isinstance(value, float) else str(value)


def joined(parts: Sequence[str], between: str = ", ") -> str:
    """Return parts one behind the other."""
    if len(parts) < 2:
        return parts[0] if parts else ""
    gaps = [f"p{n}" for n in range(len(parts))]
    return Sentence(between.join(f"{{{g}}}" for g in gaps), dict(zip(gaps, parts, strict=True)))


def listed(parts: Sequence[str], *, alternatives: bool = False) -> str:
    """Return "a, b and c", or "a, b or c"."""
    if len(parts) < 2:
        return parts[0] if parts else ""
    head, last = joined(parts[:-1]), parts[-1]
    if alternatives:
        return sentence("{head} or {last}", head=head, last=last)
    return sentence("{head} and {last}", head=head, last=last)


@cache
def catalogue(language: str) -> Mapping[str, str]:
    """Return the words of a language by the English ones; KeyError where there is no such language."""
    if language not in LANGUAGES:
        raise KeyError(language)
    if language == ENGLISH:
        return {}
    texts: Mapping[str, str] = json.loads(
        (Path(__file__).parent / f"{language}.json").read_text(encoding="utf-8")
    )
    return texts


def say(text: str, language: str = ENGLISH) -> str:
    """Return a text in a language; as it is where nothing is known of it but its letters."""
    if language == ENGLISH:
        return str(text)
    if isinstance(text, Sentence):
        return text.in_words_of(language)
    # The one thing beside words that differs: German writes a decimal comma.
    return text.replace(".", ",") if isinstance(text, Figure) else text


# --- beside a document ----------------------------------------------------------------------------
def mapped(document: Any, leaf: Callable[[Any], Any]) -> Any:
    """Return plain dicts and lists of a document, every leaf as ``leaf`` has it."""
    if isinstance(document, Mapping):
        return {k: mapped(v, leaf) for k, v in document.items()}
    if isinstance(document, list | tuple):
        return [mapped(v, leaf) for v in document]
    # A body of pydantic within another one is gone through, too.
    return mapped(vars(document), leaf) if hasattr(type(document), "model_fields") else leaf(document)


def wording_of(document: Any) -> dict[str, Any]:
    """Return ``{English text: {template, values}}`` of every sentence in a document, for other languages."""
    found = list[Sentence]()
    mapped(document, lambda leaf: found.append(leaf) if isinstance(leaf, Sentence) else None)
    return {str(text): _to_json(text) for text in found}


def with_wording(document: Mapping[str, Any]) -> dict[str, Any]:
    """Return a document with the table ``wording`` of its sentences, where it has any."""
    table = wording_of(document)
    return {**document, "wording": table} if table else dict(document)


def as_sentences(document: Any) -> Any:
    """Return a document that was read, its texts as the sentences that its table ``wording`` has of them."""
    if not isinstance(document, dict) or not isinstance(document.get("wording"), dict):
        return document
    rest = dict(document)
    known = {text: _from_json(told) for text, told in rest.pop("wording").items()}
    return mapped(rest, lambda leaf: known.get(leaf, leaf) if isinstance(leaf, str) else leaf)


def _to_json(text: str) -> Any:
    if isinstance(text, Sentence):
        told = {"template": text.template, "values": {k: _to_json(v) for k, v in text.values.items()}}
        return {**told, "form": text.form} if text.form else told
    return {"figure": str(text)} if isinstance(text, Figure) else text


def _from_json(told: Any) -> str:
    if not isinstance(told, dict):
        return str(told)
    if "figure" in told:
        return Figure(told["figure"])
    values = {k: _from_json(v) for k, v in told["values"].items()}
    return Sentence(told["template"], values, told.get("form", ""))


def lower_first(text: str) -> str:
    """Return the text with its first letter small, unless it begins with a name such as A1."""
    return text if text[1:2].isdigit() or text[:2].isupper() else text[:1].lower() + text[1:]
