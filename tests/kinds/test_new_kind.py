"""A kind is added as the page says: a copy of a folder and one line, to a report and a service.

What is a column of rooms, what people and the sun bring in, is a series of the copy.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import vppres
from vppres import RunOptions, run_day
from vppres.io import find_scenario, read_scenario
from vppres.io.digest import scenario_digest

PACKAGE = Path(vppres.__file__).parent
FIRST, LAST = 59, 62
"""Two steps with grid of a hot day, and one without."""
WARM_C = 26.0
"""Where the comfort bands end, so that machines run."""
NAMES = (
    ("kinds.cooling", "kinds.pools"),
    ("thermal_loads", "pools"),
    ("thermal_load", "pool"),
    ("thermal loads", "pools"),
    ('"th_', '"po_'),
    ("indoor_", "water_"),
    ("thermostat_ordered_", "valve_ordered_"),
    ('"prepared"', '"readied"'),
    ('"cooled or heated ahead"', '"readied for an outage"'),
)
"""What is renamed in the copy: folder, file, field, table, item, letters, what is read and done."""
GAIN = "pools.csv,gain_kw,number,kW,-1000,1000,0,"
SERIES = (
    ("attributes.csv", GAIN, "[files],pool_gain_kw,file,,,,pool_gain_kw.csv,file of the gains\n"
        "pool_gain_kw.csv,time,text,,,,required,beginning of the step\n"
        "pool_gain_kw.csv,pool_gain_kw,number,kW,-1000,1000,required,"),
    ("__init__.py", '    key = "pools"\n',
        '    key = "pools"\n    series = {"pool_gain_kw": "Gains."}\n'),
    ("__init__.py", "    gain_kw: Floats = field(default_factory=no_items)\n", ""),
    ("physics.py", "np.broadcast_to(loads.gain_kw, begins_c.shape)",
        "scenario.pool_gain_kw[steps.start : steps.stop]"),
    ("physics.py", "loads.gain_kw", "self.scenario.pool_gain_kw[t]"),
)  # fmt: skip
"""What makes a series of a column in the copy: file, and one text instead of another."""
SITE = """
import json, sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
import numpy as np
import pandapower as pp
import pandas as pd
from vppres import Controller, Measurement, RunOptions, run_day
from vppres.io import read_scenario
options = RunOptions(horizon_h=1.0, isolate=False)
"""
RUN = f"""{SITE}
from tests.support.played_service import played
from vppres.explain.day import explain_day
from vppres.report.sections.explain import ACTIONS
from vppres.report.run_folder import write_run
from vppres.service.operation.site import Service
from vppres.service.simulate import Play

day = read_scenario("day").between({FIRST}, {LAST})
run = run_day(day, options)
summary = write_run(explain_day(run), Path("run"))
player = played(Service(day, options, rehearsal=True), day, Path("live"), Play(announced=False))
live_kw = [kw for record in player.world.records for kw in record.kinds["pools"]["p_kw"]]

net = pp.create_empty_network()
bus_of = {{pp.create_bus(net, 0.4): bus for bus in day.network.buses}}
pp.create_ext_grid(net, 0)
for bus in bus_of:
    pp.create_load(net, bus, 0.001)
feeder = SimpleNamespace(bus_of=bus_of)

def in_net():
    loads = net.load[net.load["name"].fillna("").str.startswith("machine ")]
    return dict(zip(loads["name"], loads["p_mw"] * 1e3))

run.apply_to(net, feeder, day.grid.times[0])
of_run = in_net()
told = Controller.of(day, options).step(Measurement(day.grid.times[0]))
told.apply_to(net, feeder)
print(json.dumps([summary["pools"], run.pools["p_kw"].tolist(), live_kw, player.tally.statuses,
                  of_run, in_net(), told.pools["p_kw"].to_dict(), ACTIONS["readied"]]))
"""
LATER = f"""{SITE}
from tests.support.played_service import played
from vppres.service.clock import SetClock
from vppres.service.operation.site import Service
from vppres.service.simulate import Play

week = read_scenario("day")
times, zone = week.grid.times, week.grid.zone
hour = np.asarray(times.tz_convert(zone).hour, dtype=float)
gain_kw = week.pool_gain_kw * (1.0 + np.sin(hour / 4.0))[:, None]
week = replace(week, pool_gain_kw=gain_kw, chargers=type(week.chargers)(), warnings=(),
               sessions=type(week.sessions)())
part = week.between(14, 18)
run = run_day(part, options)
begin = part.grid.start + pd.Timedelta(weeks=52)
later = replace(part, grid=replace(part.grid, start=begin))
player = played(Service(week, options, paced=True), later, Path("later"), Play(), SetClock(begin))
live_kw = [kw for record in player.world.records for kw in record.kinds["pools"]["p_kw"]]
print(json.dumps([run.pools["p_kw"].tolist(), live_kw, player.tally.statuses]))
"""
WRONG = f"""{SITE}
from vppres.io import write_scenario
from vppres.io.python_door import check_scenario
from vppres import InputError

said = []
def told(asked):
    try:
        asked()
    except InputError as error:
        said.append(str(error))

day = read_scenario("day")
write_scenario(day, "again")
same = bool((read_scenario("again").pool_gain_kw == day.pool_gain_kw).all())
file = Path("again/pool_gain_kw.csv")
text = file.read_text()
for old, new in ((",rooms-04", ",rooms-99"), ("2025-07-13T23:00", "2025-07-13T22:00")):
    assert old in text
    file.write_text(text.replace(old, new, 1))
    told(lambda: read_scenario("again"))
file.unlink()
told(lambda: read_scenario("again"))
told(lambda: check_scenario(replace(day, pool_gain_kw=day.pool_gain_kw[:, :1])))
told(lambda: check_scenario(replace(day, pool_gain_kw=day.pool_gain_kw + 1e4)))
controller = Controller.of(day, options)
controller.extend(replace(day, grid=replace(day.grid, start=day.grid.end)))
longer = controller.scenario.pool_gain_kw
print(json.dumps([same, bool((longer == np.vstack([day.pool_gain_kw] * 2)).all()), said]))
"""

WITHOUT = f"""
import json
from vppres.io import read_scenario, write_scenario
from vppres.io.digest import scenario_digest
day = read_scenario("{find_scenario("two-outages-cigre-mv")}")
write_scenario(day, "without")
print(json.dumps([scenario_digest(day), scenario_digest(read_scenario("without"))]))
"""


@pytest.fixture(scope="module")
def copied(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a package that has the copy, and with a day of it."""
    tmp_path = tmp_path_factory.mktemp("copied")
    package = tmp_path / "vppres"
    shutil.copytree(PACKAGE, package, ignore=shutil.ignore_patterns("__pycache__", "scenarios"))
    folder = shutil.copytree(package / "kinds" / "cooling", package / "kinds" / "pools")
    for file in folder.iterdir():
        text = file.read_text(encoding="utf-8")
        for old, new in NAMES:
            text = text.replace(old, new)
        file.write_text(text, encoding="utf-8")
    for name, old, new in SERIES:
        text = (folder / name).read_text(encoding="utf-8")
        assert old in text, old
        (folder / name).write_text(text.replace(old, new, 1), encoding="utf-8")
    table = package / "kinds" / "table.py"
    folders = table.read_text(encoding="utf-8").replace(
        "FOLDERS = {", 'FOLDERS = {\n    "pools": "pools",'
    )
    table.write_text(folders, encoding="utf-8")
    day = shutil.copytree(find_scenario("village-hot-week"), tmp_path / "day")
    rooms = pd.read_csv(day / "thermal_loads.csv").assign(t_initial_c=WARM_C)
    rooms.drop(columns="gain_kw").to_csv(day / "pools.csv", index=False)
    (day / "thermal_loads.csv").unlink()
    gains = pd.read_csv(day / "load_kw.csv")[["time"]]
    gains[rooms["id"]] = rooms["gain_kw"].to_numpy()
    gains.to_csv(day / "pool_gain_kw.csv", index=False)
    return tmp_path


def told(folder: Path, code: str) -> Any:
    """What a script says with the package of a folder."""
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=folder,  # whose package goes before that of the tests
        env={**os.environ, "PYTHONPATH": str(PACKAGE.parent)},
        capture_output=True,
        text=True,
        check=True,
    )
    return json.loads(done.stdout)


@pytest.mark.daily
def test_a_copy_of_a_kind_is_a_kind(copied: Path) -> None:
    figures, p_kw, live_kw, statuses, of_run, of_live, set_kw, action = told(copied, RUN)
    village = read_scenario(find_scenario("village-hot-week")).between(FIRST, LAST)
    loads = village.thermal_loads
    warm = replace(loads, t_initial_c=np.full(len(loads), WARM_C))
    village = replace(village, thermal_loads=warm)
    run = run_day(village, RunOptions(horizon_h=1.0, isolate=False))
    assert p_kw == pytest.approx(run.thermal_loads["p_kw"].tolist(), abs=1e-6)
    assert live_kw == pytest.approx(p_kw, abs=1e-6) and statuses == {"ok": LAST - FIRST}
    named = [f"machine {name}" for name in village.thermal_loads.id]
    first_kw = dict(zip(named, p_kw[: len(named)], strict=True))
    assert max(p_kw) > 0.1 and of_run == pytest.approx(first_kw, abs=1e-6)
    of_table = {f"machine {name}": kw for name, kw in set_kw.items()}
    assert of_live == pytest.approx(of_table, abs=1e-12)
    assert of_live == pytest.approx(of_run, abs=1e-6)
    assert figures["machines_kwh"] == pytest.approx(run.thermal_loads["p_kw"].sum(), abs=1e-6)
    page = (copied / "run" / "report.html").read_text(encoding="utf-8")
    assert "rooms and tanks come after service" in page
    assert action == "readied for an outage"
    assert ": pools" in (copied / "run" / "figures" / "import_load_pv.svg").read_text("utf-8")


@pytest.mark.daily
def test_a_service_of_another_year_has_the_series_of_the_same_hour(copied: Path) -> None:
    p_kw, live_kw, statuses = told(copied, LATER)
    assert max(p_kw) > 0.0
    assert live_kw == pytest.approx(p_kw, abs=1e-5) and statuses == {"ok": 4}


@pytest.mark.daily
def test_a_site_without_the_kind_is_the_site_that_it_was(copied: Path) -> None:
    """Saved states and runs name the digest of their site."""
    own = scenario_digest(read_scenario(find_scenario("two-outages-cigre-mv")))
    assert told(copied, WITHOUT) == [own, own]


@pytest.mark.daily
def test_a_series_of_a_kind_is_checked_as_demand_is(copied: Path) -> None:
    same, longer, said = told(copied, WRONG)
    assert same and longer
    unknown, early, missing, narrow, large = said
    assert "pool_gain_kw.csv" in unknown and "rooms-99" in unknown
    assert "is not a step of the scenario" in early
    assert "pool_gain_kw.csv: the file is missing" in missing
    assert "is not of shape" in narrow
    assert "must lie between -1000 and 1000" in large
