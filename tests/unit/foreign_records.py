"""What tests of imports share: files written, a first map asked for, a map that is read."""

import json
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import yaml
from mcap.writer import Writer

from invid.cli.app import run
from invid.recording import Recording, read_recording


def text(path: Path, lines: Iterable[str]) -> Path:
    """A file of these lines."""
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def table(path: Path, names: list[str], *columns: np.ndarray, sep: str = ",") -> Path:
    rows = [sep.join(f"{v:.9g}" for v in row) for row in zip(*columns, strict=True)]
    return text(path, [sep.join(names)] * bool(names) + rows)


def json_bag(path: Path, messages: list[tuple[str, int, dict]]) -> Path:
    """MCAP of messages by topic and time [ns]."""
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema("s", "jsonschema", b"{}")
        channels = {t: writer.register_channel(t, "json", schema) for t, _, _ in messages}
        for topic, at, body in messages:
            writer.add_message(channels[topic], at, json.dumps(body).encode(), at)
        writer.finish()
    return path


def suggested(capsys, *sources: Path | str, status: int = 0) -> dict:
    """What ``--suggest`` says; options may stand among the sources."""
    capsys.readouterr()
    assert run(["import", *map(str, sources), "--suggest", "--json"]) == status
    return json.loads(capsys.readouterr().out)


def written_map(folder: Path, chart: dict) -> list[str]:
    """The options that give an import this map, and where it writes."""
    path = folder / "map.yaml"
    path.write_text(yaml.safe_dump({"format": "invid-import-map", **chart}, allow_unicode=True), "utf-8")
    return ["--map", str(path), "-o", str(folder / "r.h5")]


def imported(folder: Path, source: Path | list[Path], chart: dict) -> Recording:
    sources = [source] if isinstance(source, Path) else source
    assert run(["import", *map(str, sources), *written_map(folder, chart)]) == 0
    return read_recording(folder / "r.h5")


def refused(capsys, folder: Path, sources: list[Path], chart: dict) -> dict:
    """What is said of an import that is refused."""
    capsys.readouterr()
    assert run(["import", *map(str, sources), *written_map(folder, chart), "--json"]) == 2
    return json.loads(capsys.readouterr().out)["refused"]
