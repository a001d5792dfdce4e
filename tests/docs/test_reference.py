"""The reference of recordings and maps keeps step with the code."""

import math
import re
from pathlib import Path

import numpy as np
import pytest
from pydantic import BaseModel

from invid.recording import import_map, read_recording
from invid.recording.stored import ExperimentAttributes, RootAttributes
from invid_drivers.cia402.axis_state import RULES, AxisState, Command, longest_way_out
from invid_drivers.cia402.bus import STOPPED_S
from invid_drivers.relay import STOP_S

PAGE = (Path(__file__).parents[2] / "docs" / "reference" / "recording.md").read_text(encoding="utf-8")
WORDS = set(re.findall(r"\w+", PAGE))


def fields_of_the_map() -> list[tuple[str, str]]:
    models = [m for m in vars(import_map).values() if isinstance(m, type) and issubclass(m, BaseModel)]
    return [(m.__name__, f) for m in models for f in m.model_fields]


@pytest.mark.parametrize(("model", "name"), fields_of_the_map())
def test_every_key_of_the_import_map_is_in_the_reference(model: str, name: str) -> None:
    assert name in WORDS, f"{model}.{name}"


@pytest.mark.parametrize("name", sorted({*RootAttributes.model_fields, *ExperimentAttributes.model_fields}))
def test_every_attribute_of_a_recording_is_in_the_reference(name: str) -> None:
    assert f"`{name}`" in PAGE


def test_the_example_with_h5py_writes_a_recording_that_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(0)
    for name in ("position", "torque"):
        np.save(f"{name}.npy", rng.normal(size=(20480, 2)))
    (code,) = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)
    exec(compile(code, "recording.md", "exec"), {})
    recording = read_recording(tmp_path / "cell.h5")
    assert recording.axes == ("A1", "A2")
    assert recording.experiments[0].periods == 5


def test_the_bounds_of_a_stop_on_the_safety_page_are_those_of_the_table_of_states() -> None:
    page = (Path(__file__).parents[2] / "docs" / "explanations" / "safety.md").read_text(encoding="utf-8")
    assert f"({longest_way_out():g} s at most)" in page
    assert f"| {STOPPED_S:.0f} s (`longest_stop_s` of `check`) |" in page
    assert f"| command or service for the cycle process | {STOP_S:.0f}," in page


S = AxisState
STATES = {
    "being enabled": (S.ENABLING,), "held, led": (S.HELD, S.LED),
    "without power for another mode": (S.SWITCHING,), "brought to rest": (S.STOPPING,),
    "in a quick stop": (S.PARKING,), "held in quick stop active": (S.STANDS,),
    "handed to its brake": (S.BRAKING,), "held by its brake": (S.BRAKED,),
    "let go, and caught": (S.CATCHING,), "slowed by torque of the other sign": (S.SLOWING,),
    "held again until it is supported": (S.CAUGHT,), "being switched off": (S.LETTING_GO, S.OFF),
}  # fmt: skip
SENT = {Command.DISABLE: "0", Command.STAND_BY: "7", Command.QUICK_STOP: "2", Command.ENABLE: "15"}


@pytest.mark.parametrize("row", STATES)
def test_what_each_state_sends_and_its_deadline_on_the_safety_page_are_those_of_the_table(row: str) -> None:
    page = (Path(__file__).parents[2] / "docs" / "explanations" / "safety.md").read_text(encoding="utf-8")
    (line,) = (x for x in page.splitlines() if x.startswith(f"| {row} |"))
    _, _, word, _, deadline, _, _ = line.split("|")
    for rule in (RULES[s] for s in STATES[row]):
        assert re.search(r"\d+", word)[0] == SENT[rule.command]  # type: ignore[index]
        if math.isfinite(rule.within_s):
            assert f"{rule.within_s:g}" in re.findall(r"[\d.]+", deadline)
