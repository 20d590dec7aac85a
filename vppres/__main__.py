"""``python -m vppres`` is the command ``vppres``."""

from __future__ import annotations

from vppres.cli.commands import main

if __name__ == "__main__":
    main()
