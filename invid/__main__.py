"""``python -m invid`` is ``invid``."""

from invid.cli import main

main()
