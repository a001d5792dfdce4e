"""The command line ``invid``: one module a command; drivers and service register theirs by entry point."""

from invid.cli.app import main

__all__ = ["main"]
