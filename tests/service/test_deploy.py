"""Files to run the service with: they name options, figures and units that exist."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from typer.testing import CliRunner

from tests.support.asgi import Caller
from tests.support.tiny_day import tiny_scenario
from vppres.cli import commands
from vppres.day.options import RunOptions
from vppres.service.access import Access
from vppres.service.http.app import make_app
from vppres.service.http.serve import opened
from vppres.service.operation.site import Service
from vppres.service.storage.records import Reading, seconds

DEPLOY = Path(__file__).parents[2] / "docs" / "deploy"
HOWTO = DEPLOY.parent / "howto" / "deploy.md"
METRIC = re.compile(r"\bvppres_[a-z_]+")


@pytest.fixture(scope="module")
def figures(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Value by figure with labels, after the first step of an outage."""
    served = Service(tiny_scenario(), RunOptions(horizon_h=0.0, isolate=False), rehearsal=True)
    with opened(served, tmp_path_factory.mktemp("live")) as runner:
        dark = runner.scenario.grid.times[3]
        heard = [Reading(b, "soc", seconds(dark), "scada", 3600, 0.8) for b in ("big", "small")]
        runner.store.write_readings(heard, dark)
        runner.step(dark)
        text = Caller(make_app(runner, Access())).get("/metrics").content.decode()
    rows = [line.rpartition(" ") for line in text.splitlines() if not line.startswith("#")]
    return {name: value for name, _, value in rows}


def test_figures_are_those_of_the_step(figures: dict[str, str]) -> None:
    assert figures["vppres_grid_available"] == "0.0"
    assert figures["vppres_import_limit_watts"] == "0.0"
    assert figures["vppres_outage_probability_ratio"] == "1.0"
    assert figures['vppres_served_customers{tier="critical"}'] == "1.0"
    assert figures['vppres_fallback_info{kind="none"}'] == "1.0"
    assert figures['vppres_mode_info{mode="auto"}'] == "1.0"
    assert (
        0.9
        < float(figures["vppres_voltage_min_ratio"])
        <= float(figures["vppres_voltage_max_ratio"])
    )
    assert 0.15 < float(figures['vppres_battery_soc_ratio{asset="big"}']) < 0.8


@pytest.mark.parametrize("file", ["grafana.json", "alerts.yml", "../howto/deploy.md"])
def test_files_name_figures_that_there_are(file: str, figures: dict[str, str]) -> None:
    known = {name.partition("{")[0] for name in figures}
    named = set(METRIC.findall((DEPLOY / file).read_text(encoding="utf-8")))
    if file.endswith(".md"):
        named.discard("vppres_step_duration_seconds")  # the family of a histogram
    assert named and named <= known


def test_the_board_can_be_read() -> None:
    board = json.loads((DEPLOY / "grafana.json").read_text(encoding="utf-8"))
    places = set()
    for panel in board["panels"]:
        assert panel["title"] and panel["fieldConfig"]["defaults"]["unit"]
        at = panel["gridPos"]
        cells = {
            (x, y)
            for x in range(at["x"], at["x"] + at["w"])
            for y in range(at["y"], at["y"] + at["h"])
        }
        assert not cells & places and at["x"] + at["w"] <= 24, panel["title"]
        places |= cells
    assert len({panel["id"] for panel in board["panels"]}) == len(board["panels"])


@pytest.mark.parametrize("file", ["vppres.service", "Containerfile", "../howto/deploy.md"])
def test_options_exist(file: str) -> None:
    asked = CliRunner().invoke(commands.app, ["serve", "--help"], env={"COLUMNS": "200"})
    text = (DEPLOY / file).read_text(encoding="utf-8")
    calls = re.findall(r'vppres"?,? "?serve"?,? [^\n]*|vppres --[^\n]*', text)
    assert calls
    for option in set(re.findall(r"--[a-z-]+", " ".join(calls))) - {"--speed", "--rm"}:
        assert f"{option} " in asked.output, option


def test_systemd_takes_the_unit(tmp_path: Path) -> None:
    analyze = shutil.which("systemd-analyze")
    if analyze is None:
        pytest.skip("no systemd-analyze on the path")
    unit = tmp_path / "vppres.service"
    text = (DEPLOY / "vppres.service").read_text(encoding="utf-8")
    unit.write_text(text.replace("/opt/vppres/bin/vppres", "/bin/true"), encoding="utf-8")
    found = subprocess.run([analyze, "verify", str(unit)], capture_output=True, text=True)
    ours = [line for line in found.stderr.splitlines() if "vppres.service" in line]
    assert ours == []
