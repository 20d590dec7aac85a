"""A kind is added as the page says: a copy of a folder and one line, from a CSV file to a report."""

from __future__ import annotations

import json
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
)
"""What is renamed in the copy: the folder, its file, field, table and item, and its letters."""
RUN = f"""
import json, sys
from pathlib import Path
from vppres import RunOptions, run_day
from vppres.explain.day import explain_day
from vppres.io import read_scenario
from vppres.report.run_folder import write_run

run = run_day(read_scenario("day").between({FIRST}, {LAST}), RunOptions(horizon_h=1.0))
summary = write_run(explain_day(run), Path("run"))
print(json.dumps([summary["pools"], run.pools["p_kw"].tolist()]))
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
        [sys.executable, "-c", RUN], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    figures, p_kw = json.loads(done.stdout)
    village = read_scenario(find_scenario("village-hot-week")).between(FIRST, LAST)
    run = run_day(village, RunOptions(horizon_h=1.0))
    assert run.thermal_loads is not None
    assert p_kw == pytest.approx(run.thermal_loads["p_kw"].tolist(), abs=1e-6)
    assert figures["machines_kwh"] == pytest.approx(run.thermal_loads["p_kw"].sum(), abs=1e-6)
    page = (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
    assert "rooms and tanks come after service" in page
