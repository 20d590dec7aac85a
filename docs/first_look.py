"""The picture that opens README and documentation: ``python docs/first_look.py``.

The packaged day at a glance: what supplied the demand, which share of each tier, what was stored.
"""

from __future__ import annotations

from pathlib import Path

import matplotlib

import vppres

FILE = Path(__file__).with_name("_static") / "first_look.svg"


def main() -> None:
    """Run the packaged day and draw it."""
    matplotlib.use("svg")
    run = vppres.run_day(vppres.load_scenario("uk-heatwave-2022"))
    with matplotlib.rc_context({"svg.hashsalt": "vppres", "hatch.linewidth": 0.6}):
        panels = run.plot("day")
        panels[0].set_title("A heat-wave day with no grid from 12:00 to 18:00", loc="left")
        panels[0].figure.savefig(FILE, metadata={"Date": None})


if __name__ == "__main__":
    main()
