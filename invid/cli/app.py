"""Builds the application from the registered commands and maps errors to exit statuses."""

from __future__ import annotations

import ast
import os
import sys
import warnings
from importlib.abc import SourceLoader
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from pathlib import Path

import typer

from invid import __version__
from invid.cli.output import emit, note
from invid.disk import is_full, not_written
from invid.errors import DiskFullError, InvidError, SafetyStop

GROUP = "invid.commands"
EXIT_INTERNAL = 70  # EX_SOFTWARE of sysexits.h: not one of the contract's, because it is our fault
INTERRUPTED = 130  # what Typer makes of Ctrl-C: 128 + SIGINT

# Newer Typer carries its own copy of click, older ones import it: the base of BadParameter is the
# usage error in both.
UsageError: type[Exception] = next(c for c in typer.BadParameter.__mro__ if c.__name__ == "ClickException")


def create_app(command: str | None = None, *, overview: bool = False) -> typer.Typer:
    """The application with every registered command, or with the one named alone.

    Commands pull in what they need (numba, the web, the bus); loading only the one asked for keeps
    every command quick to start. ``overview``: where no command of that name is registered none is loaded,
    for a help text or a message that names them.
    """
    app = typer.Typer(
        name="invid",
        no_args_is_help=True,
        add_completion=False,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
        help="Identify the elastic model of robot drives over CAN, and say what the simulation gets wrong.",
    )

    @app.callback(invoke_without_command=True)
    def _root(
        context: typer.Context,
        _version: bool = typer.Option(False, "--version", help="Print the version and exit."),
    ) -> None:
        if context.invoked_subcommand is None:
            typer.echo(context.get_help())
            raise typer.Exit(2)

    points = sorted(entry_points(group=GROUP), key=lambda p: p.name)
    wanted = [p for p in points if p.name == command]
    for point in wanted or points:
        if overview and not wanted:
            app.command(point.name, help=_summary(point))(_unloaded)
        else:
            point.load()(app)
    return app


def _summary(point: EntryPoint) -> str:
    """Return what a command does: its module's docstring behind its name, read without loading it."""
    spec = find_spec(point.module)
    source = spec.loader.get_source(point.module) if spec and isinstance(spec.loader, SourceLoader) else None
    first = (ast.get_docstring(ast.parse(source or "")) or "").partition("\n")[0]
    text = first.partition(f"``invid {point.name}``: ")[2].partition("; ``")[0].rstrip(".")
    return f"{text[:1].upper()}{text[1:]}."


def _unloaded() -> None:
    """Stands for a command in the overview, which runs none."""


def main(arguments: list[str] | None = None) -> None:
    """Run one command; every error raised on purpose is one message and its exit status."""
    # A trial step of a search may overflow: it is judged by its cost, and nobody can act on the warning.
    warnings.filterwarnings("ignore", category=RuntimeWarning)
    warnings.filterwarnings("default", message="numba cannot be used", category=RuntimeWarning)
    sys.exit(run(sys.argv[1:] if arguments is None else arguments))


def run(arguments: list[str]) -> int:
    """Exit status of one command line."""
    if arguments == ["--version"]:
        print(__version__)
        return 0
    try:
        named = next((a for a in arguments if not a.startswith("-")), None)
        result = create_app(named, overview=True)(args=arguments, standalone_mode=False, prog_name="invid")
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except InvidError as error:
        note(f"invid: {error}")
        if "--json" in arguments:
            # Refused: a program branches on the code, and has what was measured. Stopped: what was recorded
            # so far is in the file that the command named.
            refused = {"code": error.word, "reason": error.reason, "way_out": error.way_out}
            how = {"outcome": "aborted"} if isinstance(error, SafetyStop) else {}
            document = {"result": None, "refused": refused | {"values": error.values}, **how}
            emit(document | {"warnings": [str(error)]}, "", as_json=True)
        return error.exit_code
    except UsageError as error:
        error.show(file=sys.stderr)  # type: ignore[attr-defined]
        return 2
    except (typer.Abort, KeyboardInterrupt):
        note("invid: interrupted")
        return 4
    except Exception as error:
        if os.environ.get("INVID_DEBUG"):
            raise
        if isinstance(error, OSError) and is_full(error):
            note(f"invid: {not_written(Path(error.filename or 'the output'), error)}")
            return DiskFullError.exit_code
        note(
            f"invid: internal error, please report it: {type(error).__name__}: {error} "
            "(set INVID_DEBUG=1 and run again to see where)"
        )
        return EXIT_INTERNAL
    if result == INTERRUPTED:
        note("invid: interrupted")
    return result if isinstance(result, int) else 0
