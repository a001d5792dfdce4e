"""Pages of the documentation as programs: their commands, what they show, what is printed instead."""

import contextlib
import io
import re
import shlex
from dataclasses import dataclass
from pathlib import Path

import pytest

from invid.cli.app import run
from invid.numerics import run_clock

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT.parent / "shared" / "data"
_BLOCK = re.compile(r"```sh\n(.*?)```(?:\s*```text\n(.*?)```)?", flags=re.DOTALL)
_NUMBER = re.compile(r"(?<![\w.])[+-]?\d+(?:\.\d+)?(?:e[+-]?\d+)?")


@dataclass(frozen=True)
class Step:
    """One shell block with one text block below it: the words of its commands, and what it shows."""

    commands: tuple[tuple[str, ...], ...]
    shown: str | None


@dataclass(frozen=True)
class Ran:
    """One step, run: exit statuses and what stood on stdout."""

    step: Step
    statuses: tuple[int, ...]
    printed: str


def steps(page: Path) -> list[Step]:
    """All steps of a page, with absolute paths to the data and the maps."""
    found = []
    for block, shown in _BLOCK.findall(page.read_text(encoding="utf-8")):
        lines = [shlex.split(line) for line in block.splitlines() if line.strip()]
        found.append(Step(tuple(tuple(_absolute(w) for w in words) for words in lines), shown or None))
    return found


def _absolute(word: str) -> str:
    return re.sub(r"^configs/", f"{ROOT}/configs/", re.sub(r"^records\b", str(DATA), word))


def run_page(page: Path, where: Path) -> list[Ran]:
    """Every command of the page, word for word and with the reader's budget, in the folder ``where``; skipped
    loudly where its data are not there.
    """
    words = {w for s in steps(page) for c in s.commands for w in c}
    missing = sorted(w for w in words if w.startswith(str(DATA)) and not Path(w).exists())
    if missing:
        reason = f"measured data are not there ({', '.join(missing)}): {page.name} is NOT checked"
        print(reason)
        pytest.skip(reason)
    ran = []
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(where)
        # A reader's computer has nothing else to do: the budget is the processor's time alone.
        patch.setattr(run_clock, "MOST_WALL", float("inf"))
        for step in steps(page):
            out, statuses = io.StringIO(), []
            with contextlib.redirect_stdout(out):
                for words in step.commands:
                    assert words[0] == "invid"
                    statuses.append(run(list(words[1:])))
            ran.append(Ran(step, tuple(statuses), out.getvalue()))
    return ran


LEFT_OUT = "…"
"""A line of a page that stands for any number of printed ones."""


def assert_shows(ran: Ran, *, within: float = 0.05) -> None:
    """The page shows what was printed: the same words in the same lines, numbers to ``within``.

    Not to the last digit: another processor rounds otherwise, and iterations end elsewhere. The last printed
    digit of a number may always be one off.
    """
    assert ran.step.shown is not None
    shown, printed = ran.step.shown.strip().splitlines(), ran.printed.strip().splitlines()
    for told, said in _pairs(shown, printed):
        for a, b in zip(_NUMBER.findall(told), _NUMBER.findall(said), strict=True):
            most = max(within * abs(float(b)), 1.01 * _last_digit(b))
            assert abs(float(a) - float(b)) <= most, f"the page shows {a}, printed is {b}, in: {said}"


def _pairs(shown: list[str], printed: list[str]) -> list[tuple[str, str]]:
    """Lines of the page with those printed, in the order printed and next to each other but at "…"."""
    pairs, at, free = [], 0, False
    for line in shown:
        if line == LEFT_OUT:
            free = True
            continue
        rest = [_skeleton(said) for said in printed[at : None if free else at + 1]]
        assert _skeleton(line) in rest, f"not printed{'' if free else ' here'}: {line}"
        at += rest.index(_skeleton(line)) + 1
        pairs.append((line, printed[at - 1]))
        free = False
    assert free or at == len(printed), f"printed and not shown: {printed[at:]}"
    return pairs


def _skeleton(line: str) -> str:
    return " ".join(_NUMBER.sub("#", line).split())


def _last_digit(number: str) -> float:
    mantissa, _, power = number.partition("e")
    digits = len(mantissa.partition(".")[2])
    return float(10.0 ** (int(power or 0) - digits))
