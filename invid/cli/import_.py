"""``invid import``: measured data from elsewhere to a recording."""

from __future__ import annotations

from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from invid.cli.output import emit, note
from invid.errors import InputError

if TYPE_CHECKING:
    from invid.recording.import_map import ImportMap
    from invid.recording.importer import Import


def register(app: typer.Typer) -> None:
    """Add the command."""

    @app.command("import")
    def import_command(
        source: list[Path] = typer.Argument(
            None, help="Files, or a folder that the map picks files from; else the map's 'files'."
        ),
        out: Path | None = typer.Option(None, "-o", "--out", help="Recording to write (HDF5)."),
        map_file: Path | None = typer.Option(None, "--map", help="YAML map of columns, units and roles."),
        check: Path | None = typer.Option(
            None, "--check", help="Say what this map would read of each file; write nothing."
        ),
        plots: Path | None = typer.Option(None, "--plots", help="With --check: a picture of each file here."),
        propose: bool = typer.Option(False, "--suggest", help="Print a first map, with reasons, and stop."),
        as_json: bool = typer.Option(False, "--json", help="One JSON document on stdout."),
    ) -> None:
        """Measured data from elsewhere (CSV, MAT, Parquet, HDF5, MDF, MCAP, TDMS, CAN) to a recording."""
        from invid.recording.hdf5 import write_recording
        from invid.recording.import_map import load_map
        from invid.recording.import_source import import_source

        source = source or []
        if check is not None:
            _check(source, check, plots, as_json=as_json)
            return
        chart = load_map(map_file) if map_file is not None else None
        if not source and (chart is None or propose):
            raise InputError("import: name the files to read (SOURCE), or a map that names its 'files'")
        if propose:
            _print_suggestion(source, chart, map_file, as_json=as_json)
            return
        if out is None:
            raise InputError(
                "import: say where the recording goes with -o REC.h5 (or ask for a map: --suggest)"
            )
        for path in source:
            if path.resolve() == out.resolve():
                raise InputError(f"{out}: is the source itself; give -o another name")
        created = datetime.now(UTC).isoformat(timespec="seconds")
        result = import_source(
            source, chart, created=created, beside=map_file.parent if map_file is not None else None
        )
        write_recording(result.recording, out)
        document, text = _report(result, out)
        for warning in document["warnings"]:
            note(f"warning: {warning}")
        for lack in result.cannot_tell:
            note(f"cannot tell: {lack.text}")
        emit(document, text, as_json=as_json)


def _check(source: list[Path], map_file: Path, plots: Path | None, *, as_json: bool) -> None:
    from invid.recording.import_map import load_map
    from invid.recording.import_source import check_files, describe_experiment

    created = datetime.now(UTC).isoformat(timespec="seconds")
    checks, left_out = check_files(source, load_map(map_file), created=created, beside=map_file.parent)
    good = {path: c for path, c in checks.items() if not isinstance(c, InputError)}
    files = [
        {
            "file": str(path),
            "rows": c.rows if c else 0,
            "broken_rows": len(c.broken) if c else 0,
            "experiments": [describe_experiment(e, c.recording) for e in c.recording.experiments]
            if c
            else [],
            "warnings": list(c.warnings) if c else [],
            "cannot_tell": [asdict(lack) for lack in c.cannot_tell] if c else [],
            "error": None if c else str(checks[path]),
            "error_code": getattr(checks[path], "code", "") or None,
        }
        for path, c in ((path, good.get(path)) for path in checks)
    ]
    position, torque = ("m", "N") if any(c.recording.linear for c in good.values()) else ("rad", "N·m")
    document = {
        "format": "invid-import-check",
        "format_version": 1,
        "units": {"position": position, "speed": f"{position}/s", "torque": torque},
        "files": files,
        "left_out": list(left_out),
        "pictures": [],
    }
    if plots is not None:
        from invid.report.import_pictures import draw_files

        document["pictures"] = draw_files([(p, c.recording) for p, c in good.items()], plots)
    for remark in left_out:
        note(remark)
    emit(document, _check_text(files, position, torque), as_json=as_json)
    if len(good) < len(checks):
        raise typer.Exit(2)


def _check_text(files: list[dict[str, Any]], position: str, torque: str) -> str:
    lines = []
    for file in files:
        lines.append(f"{file['file']}: {file['rows']} rows, {file['broken_rows']} broken")
        for e in file["experiments"]:
            clock = "even clock" if e["even"] else "rows at events"
            clock += f", jitter {e['jitter_ms']:.3g} ms" if e["jitter_ms"] and e["jitter_ms"] > 1e-3 else ""
            lines.append(
                f"  {e['key']} {e['role']:8} {e['rows']:8d} rows  {e['rate_hz']:10.6g} Hz  "
                f"{e['seconds']:9.3f} s  {e['missing_rows']} missing  {clock}"
            )
            for a in e["axes"]:
                ranges = (("position", position), ("speed", f"{position}/s"), ("torque", torque))
                shown = "  ".join(f"{n} {a[n][0]:.4g} … {a[n][1]:.4g} {u}" for n, u in ranges)
                lines.append(f"      {a['axis']}: {shown}")
        lines += [f"  warning: {w}" for w in file["warnings"]]
        lines += [f"  cannot tell: {lack['text']}" for lack in file["cannot_tell"]]
        lines += [f"  error: {file['error']}"] if file["error"] else []
    return "\n".join(lines)


def _print_suggestion(
    source: list[Path], chart: ImportMap | None, map_file: Path | None, *, as_json: bool
) -> None:
    from invid.recording.import_source import suggest_map

    _, proposal = suggest_map(source, chart, map_file.parent if map_file is not None else None)
    document = {
        "format": "invid-import-suggestion",
        "map": proposal.document,
        "reasons": list(proposal.reasons),
        "unsure": list(proposal.unsure),
        "fill_in": proposal.asked,
        "cannot_tell": list(proposal.cannot_tell),
    }
    emit(document, proposal.as_yaml(), as_json=as_json)


def _report(result: Import, out: Path) -> tuple[dict[str, Any], str]:
    recording = result.recording
    warnings = list(result.warnings)
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
        "cannot_tell": [asdict(lack) for lack in result.cannot_tell],
    }
    roles = {role: sum(e["role"] == role for e in experiments) for role in ("identify", "validate")}
    text = (
        f"{out}: {len(experiments)} experiments ({roles['identify']} to identify, {roles['validate']} to "
        f"validate), {sum(e.samples for e in recording.experiments)} samples of {len(recording.axes)} axes "
        f"({', '.join(recording.axes)}); {len(result.broken)} of {result.rows} rows broken and skipped"
    )
    return document, text
