"""Evidence: what was packed is worked out again; what was altered, cut or added is refused by its name."""

from __future__ import annotations

import json
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("cryptography")

from invid.bundle.archive import private_key, read_archive, write_archive
from invid.bundle.replay import pairs
from invid.errors import InputError

sys.path.insert(0, str(Path(__file__).parent))
from test_contract_surface import write_recording

# One worker makes the bundle once.
pytestmark = [pytest.mark.xdist_group("bundle"), pytest.mark.slow]


def run(*arguments: str | Path) -> tuple[int, str, str]:
    command = [sys.executable, "-m", "invid", *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=500, check=False)
    assert "Traceback" not in done.stderr
    return done.returncode, done.stdout, done.stderr


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bundle with its key, and what went into it."""
    root = tmp_path_factory.mktemp("evidence")
    write_recording(root / "rec.h5", np.arange(5, 400, 7), 5.0, 0.01)
    (root / "candump.log").write_text("(1.0) can0 181#0102\n")
    (root / "drive.eds").write_text("[FileInfo]\n")
    status, out, err = run(
        "bundle", root / "rec.h5", "-o", root / "b.zip", "--key", root / "key.pem", "--json",
        "--frames", root / "candump.log", "--eds", root / "drive.eds",
    )  # fmt: skip
    assert status == 0, err
    document = json.loads(out)
    assert document["key_made"] is True
    assert (root / "key.pem").stat().st_mode & 0o077 == 0
    assert any("firmware" in text for text in document["missing"])
    assert not any("frames" in text for text in document["missing"])
    return root


def test_every_number_is_worked_out_again(folder: Path) -> None:
    status, out, err = run("replay", folder / "b.zip", "--trust", folder / "key.pem.pub", "--json")
    assert status == 0, err
    document = json.loads(out)
    assert document["trusted"] is True
    assert document["numbers"] == document["identical"] > 100
    assert document["differences"] == []


def test_an_ro_crate_reader_finds_all_parts(folder: Path, tmp_path: Path) -> None:
    rocrate = pytest.importorskip("rocrate.rocrate")
    with zipfile.ZipFile(folder / "b.zip") as file:
        file.extractall(tmp_path)
    crate = rocrate.ROCrate(str(tmp_path))
    files = {e.id for e in crate.get_entities() if e.type == "File"}
    described = {"ro-crate-metadata.json"} | files
    assert described == set(read_archive(folder / "b.zip").parts)
    assert {"recording.h5", "model.json", "diagnosis.json", "frames/candump.log", "eds/drive.eds"} <= files


def rewritten(source: Path, target: Path, change: dict[str, bytes | None]) -> Path:
    """The ZIP with parts replaced, added or (None) left out; the rest as it was, its signature too."""
    with zipfile.ZipFile(source) as old, zipfile.ZipFile(target, "w") as new:
        parts = {n: old.read(n) for n in old.namelist()}
        for name, content in {**parts, **change}.items():
            if content is not None:
                new.writestr(name, content)
    return target


def test_whatever_part_is_altered_or_missing_is_named(folder: Path, tmp_path: Path) -> None:
    with zipfile.ZipFile(folder / "b.zip") as file:
        parts = {n: file.read(n) for n in file.namelist()}
    assert len(parts) >= 9
    for name, content in parts.items():
        middle = len(content) // 2
        altered = content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :]
        for change in (altered, None):
            bad = rewritten(folder / "b.zip", tmp_path / "bad.zip", {name: change})
            with pytest.raises(
                InputError, match=rf"bad\.zip: ({name}|manifest\.json|signature\.json):"
            ) as told:
                read_archive(bad)
            if name not in ("manifest.json", "signature.json"):
                assert f": {name}: " in str(told.value)


def test_a_part_that_was_added_or_is_there_twice_is_named(folder: Path, tmp_path: Path) -> None:
    bad = rewritten(folder / "b.zip", tmp_path / "bad.zip", {"more.txt": b"more"})
    with pytest.raises(InputError, match=r"more\.txt: was added"):
        read_archive(bad)
    with zipfile.ZipFile(bad, "a") as file, pytest.warns(UserWarning, match="Duplicate"):
        file.writestr("model.json", b"{}")
    with pytest.raises(InputError, match=r"model\.json: is there twice"):
        read_archive(bad)


def test_a_bit_flipped_or_an_end_cut_anywhere_is_refused(folder: Path, tmp_path: Path) -> None:
    whole = (folder / "b.zip").read_bytes()
    bad = tmp_path / "bad.zip"
    rng = np.random.default_rng(1)
    for length in (0, 1, 100, len(whole) // 2, len(whole) - 1):
        bad.write_bytes(whole[:length])
        with pytest.raises(InputError, match=r"bad\.zip: "):
            read_archive(bad)
    good = read_archive(folder / "b.zip").parts
    refused = 0
    for at in rng.integers(0, len(whole), 200):
        bad.write_bytes(whole[:at] + bytes([whole[at] ^ 4]) + whole[at + 1 :])
        try:
            # A flag or date of the ZIP itself may differ: then every part still is what was signed.
            assert read_archive(bad).parts == good
        except InputError:
            refused += 1
    assert refused > 150


def test_what_another_key_signed_is_refused_where_one_is_trusted(folder: Path, tmp_path: Path) -> None:
    parts = dict(read_archive(folder / "b.zip").parts)
    parts["model.json"] = parts["model.json"].replace(b"refined", b"guessed")
    write_archive(tmp_path / "forged.zip", parts, private_key(tmp_path / "other.pem")[0])
    assert read_archive(tmp_path / "forged.zip").trusted is False
    status, _, err = run("replay", tmp_path / "forged.zip", "--trust", folder / "key.pem.pub")
    assert status == 2
    assert "signature.json: was signed by the key" in err


def test_a_result_that_the_recording_does_not_give_is_said(folder: Path, tmp_path: Path) -> None:
    parts = read_archive(folder / "b.zip").parts
    model = json.loads(parts["model.json"])
    model["branches"][0]["springs"][0]["value"] *= 1.001
    (tmp_path / "m.json").write_text(json.dumps(model))
    (tmp_path / "d.json").write_bytes(parts["diagnosis.json"])
    status, _, err = run(
        "bundle", folder / "rec.h5", "-o", tmp_path / "b.zip", "--key", folder / "key.pem",
        "--model", tmp_path / "m.json", "--diagnosis", tmp_path / "d.json",
    )  # fmt: skip
    assert status == 0, err
    status, out, _ = run("replay", tmp_path / "b.zip", "--json")
    assert status == 3
    (difference,) = json.loads(out)["differences"]
    assert difference["place"] == "model.json: branches[0].springs[0].value"
    assert difference["bundled"] == pytest.approx(1.001 * difference["replayed"])
    status, _, _ = run("replay", tmp_path / "b.zip", "--tolerance", "0.01")
    assert status == 0


def test_documents_are_compared_leaf_by_leaf() -> None:
    was, now = {"a": [1, {"b": 2}], "c": "x"}, {"a": [1, {"b": 3}, 4], "d": None}
    assert [p for p in pairs(was, now) if p[1] != p[2]] == [
        ("a[1].b", 2, 3), ("a[2]", None, 4), ("c", "x", None)
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("bundle", "nothing.h5", "-o", "b.zip"), "nothing.h5"),
        (("bundle", "{0}/rec.h5", "-o", "b.zip", "--method", "guess"), "--method guess"),
        (("bundle", "{0}/rec.h5", "-o", "b.zip", "--model", "{0}/rec.h5"), "rec.h5"),
        (("replay", "{0}/rec.h5"), "its end is missing"),
        (("replay", "nothing.zip"), "cannot be read"),
        (("replay", "{0}/b.zip", "--trust", "{0}/rec.h5"), "no public key"),
    ],
)
def test_bad_requests_end_with_one_message(
    arguments: tuple[str, ...], says: str, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    status, _, err = run(*(a.format(folder) for a in arguments))
    assert status == 2, err
    assert says in err
