"""``invid import``: measured data from elsewhere to a recording."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import h5py
import typer

from invid.cli.output import emit, note
from invid.errors import InputError
from invid.recording.hdf5 import FORMAT as RECORDING_FORMAT
from invid.recording.hdf5 import read_recording, write_recording
from invid.recording.import_map import ImportMap, Source, load_map
from invid.recording.importer import Import, import_files, read_table
from invid.recording.spool import is_spool
from invid.recording.suggest import Suggestion, suggest


def register(app: typer.Typer) -> None:
    """Add the command."""

    @app.command("import")
    def import_command(
        source: list[Path] = typer.Argument(..., help="Files, or a folder that the map picks files from."),
        out: Path | None = typer.Option(None, "-o", "--out", help="Recording to write (HDF5)."),
        map_file: Path | None = typer.Option(None, "--map", help="YAML map of columns, units and roles."),
        propose: bool = typer.Option(False, "--suggest", help="Print a first map, with reasons, and stop."),
        as_json: bool = typer.Option(False, "--json", help="One JSON document on stdout."),
    ) -> None:
        """Measured data from elsewhere (CSV, MAT, Parquet, HDF5, CAN logs) to a recording."""
        chart = load_map(map_file) if map_file is not None else None
        if propose:
            _print_suggestion(source, chart, as_json=as_json)
            return
        if out is None:
            raise InputError(
                "import: say where the recording goes with -o REC.h5 (or ask for a map: --suggest)"
            )
        for path in source:
            if path.resolve() == out.resolve():
                raise InputError(f"{out}: is the source itself; give -o another name")
        warnings: list[str] = []
        if chart is None:
            ready = _already_a_recording(source)
            if ready is not None:
                write_recording(ready, out)
                emit(*_report(Import(ready, (), 0, ()), out, []), as_json=as_json)
                return
            chart, warnings = _guess(source)
        created = datetime.now(UTC).isoformat(timespec="seconds")
        result = import_files(
            source, chart, created=created, beside=map_file.parent if map_file is not None else None
        )
        write_recording(result.recording, out)
        document, text = _report(result, out, warnings)
        for warning in document["warnings"]:
            note(f"warning: {warning}")
        emit(document, text, as_json=as_json)


def _already_a_recording(source: list[Path]) -> Any:
    if len(source) != 1 or not source[0].is_file():
        return None
    if is_spool(source[0]):
        return read_recording(source[0])
    if not h5py.is_hdf5(source[0]):
        return None
    try:
        with h5py.File(source[0], "r") as file:
            named = file.attrs.get("format")
    except (OSError, RuntimeError, ValueError, TypeError):
        return None
    named = named.decode("latin-1") if isinstance(named, bytes) else named
    return read_recording(source[0]) if isinstance(named, str) and named == RECORDING_FORMAT else None


def _first_file(source: list[Path]) -> Path:
    if source[0].is_dir():
        files = sorted(p for p in source[0].rglob("*") if p.is_file())
        if not files:
            raise InputError(f"{source[0]}: the folder is empty")
        return files[0]
    return source[0]


def _print_suggestion(source: list[Path], chart: ImportMap | None, *, as_json: bool) -> None:
    path = _first_file(source)
    proposal = suggest(read_table(path, chart.source if chart else Source()), path)
    document = {
        "format": "invid-import-suggestion",
        "map": proposal.document,
        "reasons": list(proposal.reasons),
        "unsure": list(proposal.unsure),
    }
    emit(document, proposal.as_yaml(), as_json=as_json)


def _guess(source: list[Path]) -> tuple[ImportMap, list[str]]:
    """A map without a person's help: only where every column's meaning is plain from its name."""
    path = _first_file(source)
    proposal: Suggestion = suggest(read_table(path, Source()), path)
    doubts = [u for u in proposal.unsure if not u.endswith("is assumed")]
    if doubts:
        raise InputError(
            f"{path}: cannot tell the columns without a map: {doubts[0]}; write a first map with "
            f"'invid import --suggest {path}', correct it and give it with --map"
        )
    return proposal.as_map(), [f"no map was given: {u}" for u in proposal.unsure]


def _report(result: Import, out: Path, assumed: list[str]) -> tuple[dict[str, Any], str]:
    recording = result.recording
    warnings = [*assumed, *result.warnings]
    for row in result.broken[:20]:
        warnings.append(f"{row.file}, line {row.line}: {row.reason}; skipped")
    if len(result.broken) > 20:
        warnings.append(f"{len(result.broken) - 20} more rows were skipped")
    experiments = [
        {
            "key": e.key,
            "role": str(e.role),
            "kind": str(e.kind),
            "samples": e.samples,
            "duration_s": e.duration,
            "sample_rate_hz": e.sample_rate_hz,
            "period_samples": e.period_samples,
            "source_file": e.attributes.get("source_file"),
            "torque_source": e.attributes.get("torque_source"),
            "position_source": e.attributes.get("position_source", "encoder"),
        }
        for e in recording.experiments
    ]
    document: dict[str, Any] = {
        "format": "invid-import",
        "format_version": 1,
        "recording": str(out),
        "robot": recording.robot,
        "axes": list(recording.axes),
        "units": {"position": recording.position_unit, "torque": recording.torque_unit},
        "experiments": experiments,
        "rows": result.rows,
        "broken_rows": [{"file": b.file, "line": b.line, "reason": b.reason} for b in result.broken],
        "warnings": warnings,
    }
    roles = {role: sum(e["role"] == role for e in experiments) for role in ("identify", "validate")}
    text = (
        f"{out}: {len(experiments)} experiments ({roles['identify']} to identify, {roles['validate']} to "
        f"validate), {sum(e.samples for e in recording.experiments)} samples of {len(recording.axes)} axes "
        f"({', '.join(recording.axes)}); {len(result.broken)} of {result.rows} rows broken and skipped"
    )
    return document, text
