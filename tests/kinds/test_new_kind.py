"""A kind is added as the page says: a copy of a folder and one line, to a report and a service."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import vppres
from vppres import RunOptions, run_day
from vppres.io import find_scenario, read_scenario

PACKAGE = Path(vppres.__file__).parent
FIRST, LAST = 80, 84
NAMES = (
    ("kinds.cooling", "kinds.pools"),
    ("thermal_loads", "pools"),
    ("thermal_load", "pool"),
    ("thermal loads", "pools"),
    ('"th_', '"po_'),
    ("indoor_", "water_"),
)
"""What is renamed in the copy: folder, file, field, table, item, letters, and what is read."""
RUN = f"""
import json, sys
from pathlib import Path
from tests.support.played_service import played
from vppres import RunOptions, run_day
from vppres.explain.day import explain_day
from vppres.io import read_scenario
from vppres.report.run_folder import write_run
from vppres.service.operation.runner import Service
from vppres.service.simulate import Play

day, options = read_scenario("day").between({FIRST}, {LAST}), RunOptions(horizon_h=1.0)
run = run_day(day, options)
summary = write_run(explain_day(run), Path("run"))
player = played(Service(day, options, rehearsal=True), day, Path("live"), Play(announced=False))
live_kw = [kw for record in player.world.records for kw in record.kinds["pools"]["p_kw"]]
in_net = [str(name) for name in run._powers(0).drawn.index if str(name).startswith("machine ")]
print(json.dumps([summary["pools"], run.pools["p_kw"].tolist(), live_kw, player.tally.statuses, in_net]))
"""


@pytest.mark.daily
def test_a_copy_of_a_kind_is_a_kind(tmp_path: Path) -> None:
    package = tmp_path / "vppres"
    shutil.copytree(PACKAGE, package, ignore=shutil.ignore_patterns("__pycache__", "scenarios"))
    copied = shutil.copytree(package / "kinds" / "cooling", package / "kinds" / "pools")
    for file in copied.iterdir():
        text = file.read_text(encoding="utf-8")
        for old, new in NAMES:
            text = text.replace(old, new)
        file.write_text(text, encoding="utf-8")
    table = package / "kinds" / "table.py"
    folders = table.read_text(encoding="utf-8").replace(
        "FOLDERS = {", 'FOLDERS = {\n    "pools": "pools",'
    )
    table.write_text(folders, encoding="utf-8")
    day = shutil.copytree(find_scenario("village-hot-week"), tmp_path / "day")
    (day / "thermal_loads.csv").rename(day / "pools.csv")
    done = subprocess.run(
        [sys.executable, "-c", RUN],
        cwd=tmp_path,  # whose package goes before that of the tests
        env={**os.environ, "PYTHONPATH": str(PACKAGE.parent)},
        capture_output=True,
        text=True,
        check=True,
    )
    figures, p_kw, live_kw, statuses, in_net = json.loads(done.stdout)
    village = read_scenario(find_scenario("village-hot-week")).between(FIRST, LAST)
    run = run_day(village, RunOptions(horizon_h=1.0))
    assert run.thermal_loads is not None
    assert p_kw == pytest.approx(run.thermal_loads["p_kw"].tolist(), abs=1e-6)
    assert live_kw == pytest.approx(p_kw, abs=1e-6) and statuses == {"ok": LAST - FIRST}
    assert in_net == [f"machine {name}" for name in village.thermal_loads.id]
    assert figures["machines_kwh"] == pytest.approx(run.thermal_loads["p_kw"].sum(), abs=1e-6)
    page = (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
    assert "rooms and tanks come after service" in page
