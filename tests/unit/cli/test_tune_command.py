"""``invid tune`` as a user runs it."""

import json
from pathlib import Path

import pytest
from tuning.tuned import machine

from invid.cli.app import run


def test_a_model_becomes_a_folder_whose_document_is_the_next_before(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    machine().save(tmp_path / "model.json")
    model, one, two = (str(tmp_path / name) for name in ("model.json", "one", "two"))
    options = ["--draws", "50", "--json"]
    assert run(["tune", model, "-o", one, *options]) == 0
    first = json.loads(capsys.readouterr().out)
    assert first["format"] == "invid-tuning"
    assert run(["tune", model, "-o", two, "--before", f"{one}/tuning.json", *options]) == 0
    second = json.loads(capsys.readouterr().out)
    for old, new in zip(first["axes"], second["axes"], strict=True):
        assert new["before"]["gains"] == old["after"]["gains"]
        assert new["after"] == old["after"]


def test_an_untrustworthy_model_and_a_strange_before_are_one_sentence_each(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    path = tmp_path / "model.json"
    machine().save(path)
    (tmp_path / "before.json").write_text("{}", encoding="utf-8")
    assert run(["tune", str(path), "-o", str(tmp_path / "x"), "--before", str(tmp_path / "before.json")]) == 2
    assert "before.json" in capsys.readouterr().err
    document = json.loads(path.read_text(encoding="utf-8"))
    document["fit"]["trustworthy"] = False
    path.write_text(json.dumps(document), encoding="utf-8")
    assert run(["tune", str(path), "-o", str(tmp_path / "x")]) == 3
    assert "not to be trusted" in capsys.readouterr().err
    assert not (tmp_path / "x").exists()
