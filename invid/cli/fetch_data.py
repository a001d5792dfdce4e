"""``invid fetch-data``: the published records of real machines that the tutorials use."""

from __future__ import annotations

from pathlib import Path

import typer

from invid.cli.output import EXIT_OK, emit, note
from invid.errors import InputError
from invid.public_records import SETS, SOURCE


def register(app: typer.Typer) -> None:
    """Add the command."""

    @app.command("fetch-data")
    def _fetch_data(
        names: list[str] = typer.Argument(None, metavar="SET", help="Sets to fetch; without any, all."),
        to: Path = typer.Option(None, help="Folder for them; default a cache folder of yours."),
        source: str = typer.Option(SOURCE, help="Address, or a mirror's, of the repositories' files."),
        show: bool = typer.Option(False, "--list", help="Say what there is; fetch nothing."),
        as_json: bool = typer.Option(False, "--json", help="One JSON document on stdout."),
    ) -> int:
        """Published records of real machines, for the tutorials, from their authors, checked by hash, with
        the licence of each.
        """
        known = {s.name: s for s in SETS}
        unknown = [n for n in names or () if n not in known]
        if unknown:
            raise InputError(f"no set {unknown[0]!r}; there are {', '.join(known)}")
        chosen = [known[n] for n in names or known]
        where: list[Path | None] = [None] * len(chosen)
        if not show:
            from invid.public_records.fetch import cache_folder, fetch

            folder = to or cache_folder()
            for i, s in enumerate(chosen):
                note(f"{s.name}: {len(s.files)} files")
                where[i] = fetch(s, folder, source)
        rows = [
            {
                "name": s.name,
                "machine": s.machine,
                "folder": None if w is None else str(w),
                "licence": s.licence,
                "cite": s.cite,
            }
            for s, w in zip(chosen, where, strict=True)
        ]
        lines = [
            f"{s.name if w is None else w}\n  {s.machine}. Licence: {s.licence}. Cite: {s.cite}"
            for s, w in zip(chosen, where, strict=True)
        ]
        emit({"sets": rows}, "\n".join(lines), as_json=as_json)
        return EXIT_OK
