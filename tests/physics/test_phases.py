"""Phased feeders: tables, power flow against OpenDSS, linear model, plans within every phase."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from experiments.studies.phases import admittances_apart
from tests.support.command_line import call
from tests.support.homes import homes
from tests.support.phased_feeder import CIRCUIT, REGULATED, day_of, phased_day
from tests.support.set_points import asked
from tests.support.sets import gensets
from tests.support.vans import chargers, plugged_in
from vppres.contract.decision import Decision, SolveInfo
from vppres.contract.observation import Observation
from vppres.control.converged import ConvergedPlanner
from vppres.control.phased_rule import served_by_phase
from vppres.control.rules import rule_dispatch, service_order
from vppres.control.step_state import StepState
from vppres.core.errors import InputError
from vppres.day.assembly import make_controller
from vppres.day.faults import FaultPlan, SolverOutage
from vppres.day.options import RunOptions
from vppres.day.phase_figures import phase_figures
from vppres.day.simulate import Day, run_day
from vppres.day.trajectory import Trajectory
from vppres.explain.day import explain_day
from vppres.explain.windows import Windows
from vppres.feeders import import_network
from vppres.feeders.dss.phases import flow_of_source
from vppres.io import read_scenario
from vppres.io.digest import scenario_digest
from vppres.io.scenario_writer import write_scenario
from vppres.model.phases import PhasedModel, Slopes, phased_model
from vppres.model.site import Site
from vppres.physics.phased_loading import Loadings
from vppres.physics.phased_sources import (
    assets_of,
    flow_of_former,
    flow_of_grid,
    labels_by_source,
)
from vppres.physics.phases import NoPhasedSolutionError, PhasedFlow, PhasedResult
from vppres.report.findings import findings
from vppres.report.first_page import limit_rows, who_and_why
from vppres.report.one_line import step_states
from vppres.report.plots.figures import chart_of
from vppres.report.rechecked import recheck_run
from vppres.report.sections import SECTIONS
from vppres.report.sections.base import Run
from vppres.scenario.earthing import in_island, unearthed, unearthed_by
from vppres.scenario.formers import island_former
from vppres.scenario.phases import (
    PhaseBus,
    PhaseConnection,
    PhaseLine,
    Phases,
    PhaseTransformer,
)
from vppres.scenario.remarks import darkness, former_words, held_capacitors
from vppres.scenario.scenario import Scenario
from vppres.service.plans.world import World
from vppres.solve.ladder import WindowSolver
from vppres.solve.phases import MOST_BINDING, near_to
from vppres.solve.shadow_prices import PricedTerms, ShadowPriceModel, price_window

pytest.importorskip("opendssdirect")


@pytest.fixture(scope="module")
def circuit(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small unbalanced circuit with every kind of element."""
    file = tmp_path_factory.mktemp("phases") / "small.dss"
    file.write_text(CIRCUIT)
    return file


@pytest.fixture(scope="module")
def day(circuit: Path) -> Scenario:
    """A scenario of it, read back from its folder."""
    return phased_day(circuit)


def powers(day: Scenario, t: int) -> tuple[np.ndarray, np.ndarray]:
    """What all assets draw in a step, batteries idle."""
    idle = np.zeros(len(day.batteries))
    p = np.concatenate([day.load_kw[t], -day.pv_kw[t], idle])
    q = np.concatenate([day.load_kvar[t], 0.0 * day.pv_kw[t], idle])
    return p, q


def full(day: Scenario) -> Scenario:
    """The day with batteries that are full at first."""
    return replace(day, batteries=replace(day.batteries, soc_initial=day.batteries.soc_max))


def phase_kva(day: Scenario) -> float:
    """Rating of each phase of the battery that forms the day's islands."""
    return float(day.batteries.s_max_kva[day.batteries.grid_forming][0]) / 3.0


def former_kva(run: Trajectory) -> np.ndarray:
    """Power of each phase of an island's former, (T, 3)."""
    return run.steps[[f"former_{phase}_kva" for phase in "abc"]].to_numpy(float)


def first_state(day: Scenario) -> StepState:
    """What a rule knows in the first step."""
    options = RunOptions(horizon_h=0.0).on(day)
    seen = Day(day, options).observe(make_controller(day, options), 0)
    return StepState.of(Site.of(day), seen, "lossless")


def assert_as_in_opendss(run: Trajectory, circuit: Path) -> None:
    """Voltages with grid and in islands are those of the script's own power flow."""
    found = recheck_run(run, circuit).voltages
    apart = found.groupby("outage")["difference_pu"].agg(lambda off: off.abs().max())
    assert apart[False] < 1e-6 and apart[True] < 1e-6


def flows(day: Scenario) -> tuple[PhasedFlow, PhasedFlow]:
    """With the grid as source, and with the former."""
    assert day.phases
    names = assets_of(day)
    former = island_former(day)
    assert former is not None
    grid = flow_of_grid(day.phases, names, day.network.v_slack_pu)
    island = flow_of_former(day.phases, names, former, day.network.v_slack_pu, 0.947, 1.053)
    return grid, island


def test_import_has_opendss_voltages(day: Scenario) -> None:
    as_given = day.source.deviation.as_given_pu
    assert as_given is not None
    assert as_given < 1e-7
    assert not day.source.unbalanced


@pytest.mark.nightly
def test_admittances_are_those_of_opendss(circuit: Path) -> None:
    phased = import_network(circuit).phased
    assert phased is not None
    flow, _, _ = flow_of_source(phased)
    assert admittances_apart(circuit, flow) < 1e-12


@pytest.mark.nightly
def test_a_wye_with_its_neutral_at_a_phase_is_between_two_phases(circuit: Path) -> None:
    file = circuit.with_name("between.dss")
    file.write_text(CIRCUIT.replace("bc bus1=n.2.3 phases=1 conn=delta", "bc bus1=n.2.3 phases=1"))
    found = import_network(file).phased
    assert found.difference_pu is not None
    assert found.difference_pu < 1e-7
    assert "bc" in {load.connection.coils for load in found.loads}


def test_a_core_is_a_shunt_of_the_transformer_s_bus(circuit: Path) -> None:
    file = circuit.with_name("core.dss")
    file.write_text(CIRCUIT.replace("transformer.low phases=3", "transformer.low %imag=2 phases=3"))
    source = import_network(file).phased
    assert source.difference_pu is not None
    assert source.difference_pu < 1e-6
    assert [(row.bus, row.q_kvar > 0) for row in source.phases.shunts if row.bus == "d"]


def test_three_wires_have_limits_between_phases(day: Scenario) -> None:
    assert day.phases
    assert [row.bus for row in day.phases.buses if row.limits == "lines"] == ["d"]


LARGE = CIRCUIT.replace("kva=300", "kva=2000").replace("kw=90 kvar=30 model=1", "kw=900 kvar=30")
"""The largest customer and its battery are behind a transformer with a delta."""


@pytest.mark.parametrize(("substation", "low", "former", "unearthed"), [
    ("delta", "delta", "bd", {"vsource", "sourcebus", "d"}),
    ("wye", "wye", "be", {"vsource", "sourcebus", "s", "r", "m", "n", "e"}),
])  # fmt: skip
def test_an_island_is_formed_by_a_battery_that_earths_its_customers(
    tmp_path: Path, substation: str, low: str, former: str, unearthed: set[str]
) -> None:
    """A wye of the substation whose other side is a delta earths the feeder without the grid."""
    file = tmp_path / "large.dss"
    text = LARGE.replace("bus=sourcebus conn=delta", f"bus=sourcebus conn={substation}")
    text = text.replace("d phases=3 conn=delta", f"d phases=3 conn={low}")
    file.write_text(text.replace("bus=d conn=delta", f"bus=d conn={low}"))
    day = phased_day(file)
    assert day.phases
    b = day.batteries
    assert b.id[b.s_max_kva.argmax()] == "bd"
    assert list(b.id[b.grid_forming]) == [former]
    assert "nothing earths" not in former_words(day, always=True)
    behind = replace(day, batteries=replace(b, grid_forming=b.id == "bd"))
    assert unearthed_by(day.phases, "bd") == unearthed
    told = "With bd as source nothing earths the buses of ca, cb, ce, whose coils are to ground"
    assert (told in former_words(behind, always=True)) is (substation == "wye")


def test_limits_of_an_island_are_between_phases_where_nothing_earths(day: Scenario) -> None:
    """Not at a bus where an asset has a coil to ground, and of as many voltages."""
    assert day.phases
    by_source = labels_by_source(day)
    grid, island = ([word for bus, word in each if bus == "sourcebus"] for each in by_source)
    assert (grid, island) == (["a", "b", "c"], ["ab", "bc", "ca"])
    assert [bus for bus, _ in by_source[0]] == [bus for bus, _ in by_source[1]]
    connections = (*day.phases.connections, PhaseConnection("x", "sourcebus", "b", 40.0))
    changed = in_island(replace(day.phases, connections=connections), "be")
    assert ("sourcebus", "b") in changed.measured


def test_an_open_delta_earths_the_wye_only_while_it_is_fed() -> None:
    """With a third unit its delta is closed, and no shift of the wye's voltages leaves it none."""
    buses = tuple(PhaseBus(bus, bus, 1.0, "a b c") for bus in "xy")
    units = tuple(
        PhaseTransformer(wye, "x", wye, 1.0, "y", delta, 1.0, 50.0, 1.0, 4.0)
        for wye, delta in zip("abc", ("ab", "bc", "ca"), strict=True)
    )
    closed, opened = Phases(buses, (), units), Phases(buses, (), units[:2])
    assert unearthed(closed, "x", to_ground=False) == {"y"}
    assert unearthed(opened, "x", to_ground=False) == {"x", "y"}
    assert unearthed(closed, "y", to_ground=False) == {"y"}


def test_no_loading_is_stated_of_lines_whose_phases_differ(day: Scenario) -> None:
    assert not day.network.has_ratings


def test_folder_reads_back_equal(day: Scenario, tmp_path: Path) -> None:
    write_scenario(day, tmp_path / "again")
    again = read_scenario(tmp_path / "again")
    assert day.phases
    assert again.phases
    assert again.phases.key == day.phases.key


def test_slopes_are_derivatives_at_no_load(day: Scenario) -> None:
    small = 1e-3
    for flow in flows(day):
        slopes = Slopes(flow, Loadings.of(flow.phases))
        u_p, u_q = slopes.of_voltages(np.arange(len(slopes.u_0)))
        count = len(flow.assets)
        for asset in range(0, count, 3):
            p = np.zeros(count)
            p[asset] = small
            for kw, kvar, u, source in (
                (p, 0 * p, u_p, slopes.former_p),
                (0 * p, p, u_q, slopes.former_q),
            ):
                found, other = flow.solve(kw, kvar), flow.solve(-kw, -kvar)
                du = (flow.v_pu(found.v) ** 2 - flow.v_pu(other.v) ** 2) / (2 * small)
                ds = (found.source_kva - other.source_kva) / (2 * small)
                np.testing.assert_allclose(du, u[:, asset], atol=1e-7)
                changed, given = slopes.changes(kw[None, :], kvar[None, :])
                np.testing.assert_allclose(changed[0], small * u[:, asset], atol=1e-14)
                np.testing.assert_allclose(given[0], small * source[:, asset], atol=1e-14)
                np.testing.assert_allclose(ds, source[:, asset], atol=1e-4)


def test_newton_finds_what_the_fixed_point_finds(day: Scenario) -> None:
    grid, _ = flows(day)
    p, q = powers(day, 18)
    found = grid.solve(p, q)
    by_newton = grid._newton(p, q, grid.no_load_u)
    assert by_newton is not None
    assert np.abs((by_newton - found.coil_v) / grid.rated_v).max() < 1e-8


def test_load_beyond_the_lines_has_no_solution(day: Scenario) -> None:
    grid, _ = flows(day)
    p, q = powers(day, 18)
    with pytest.raises(NoPhasedSolutionError, match="collapse at"):
        grid.solve(30 * p, 30 * q)


def test_turned_phases_turn_the_answer() -> None:
    z = np.full((3, 3), 0.1 + 0.3j) + np.diag([0.3, 0.3, 0.3])
    buses = (PhaseBus("s", 1, 4.16, "a b c"), PhaseBus("e", 2, 4.16, "a b c"))
    lines = (PhaseLine("s", "e", z, np.zeros((3, 3))),)
    found = []
    for words in (("a", "bc"), ("b", "ca")):
        rows = [PhaseConnection(f"x{i}", "e", word, 2.4) for i, word in enumerate(words)]
        phases = Phases(buses, lines, connections=tuple(rows))
        flow = PhasedFlow(phases, ["x0", "x1"], [("s", 1.0)])
        found.append(flow.solve(np.array([300.0, 200.0]), np.array([100.0, 50.0])))
    np.testing.assert_allclose(found[1].source_kva, np.roll(found[0].source_kva, 1), rtol=1e-9)


def test_loadings_are_currents_over_ratings() -> None:
    z = np.full((3, 3), 0.1 + 0.3j) + np.diag([0.3, 0.3, 0.3])
    buses = [PhaseBus(name, i, 4.16, "a b c") for i, name in enumerate("sem")]
    unit = PhaseTransformer("t", "e", "a b c", 2.4, "m", "a b c", 2.4, 250.0, 1.0, 4.0, ppm=0.0)
    line = PhaseLine("s", "e", z, np.zeros((3, 3)), i_max_a=100.0)
    load = PhaseConnection("x", "m", "b", 2.4)
    phases = Phases(tuple(buses), (line,), (unit,), connections=(load,))
    flow = PhasedFlow(phases, ["x"], [("s", 1.0)])
    found = flow.solve(np.array([200.0]), np.array([80.0]))
    loadings = Loadings.of(phases)
    share = dict(zip(loadings.names, loadings.at(found.v), strict=True))
    amps = np.hypot(200.0, 80.0) * 1e3 / np.abs(found.coil_v[0])
    assert share["line from s to e, phase b"] == pytest.approx(amps / 100.0)
    assert share["transformer t, b"] == pytest.approx(amps * 2.4 / 250.0)
    assert share["line from s to e, phase a"] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(("change", "message"), [
    ({"coils": "a x"}, "phase_connections.csv, row 2, coils"),
    ({"coils": "a b c", "bus": "n"}, "has no phase a"),
    ({"bus": "nowhere"}, "is not a bus of phase_buses.csv"),
    ({"bus": "e", "coils": "a"}, "is at bus e"),
    ({"id": "stranger"}, "has no row"),
])  # fmt: skip
def test_connections_that_cannot_be(day: Scenario, change: dict[str, str], message: str) -> None:
    assert day.phases
    first, *rest = day.phases.connections
    with pytest.raises(InputError, match=message):
        replace(day, phases=replace(day.phases, connections=(replace(first, **change), *rest)))


@pytest.mark.parametrize(("options", "name"), [
    ({"mode": "paper"}, "mode"),
    ({"controller": "full-horizon"}, "controller"),
    ({"method": "monolithic"}, "method"),
])  # fmt: skip
def test_options_that_are_not_stated_are_refused_by_name(
    day: Scenario, options: dict[str, str], name: str
) -> None:
    with pytest.raises(InputError, match=f"{name} = "):
        make_controller(day, RunOptions().having(options))


@pytest.mark.nightly
def test_validate_shows_the_power_flow_by_phase(circuit: Path, day: Scenario) -> None:
    result = call("validate", circuit.parent / "small", "--power-flow", "--json")
    assert result.exit_code == 0
    found = json.loads(result.stdout)["power_flow"]
    assert found["mismatch_kva"] < 1e-3 and found["unsolved"] == 0
    grid, _ = flows(day)
    busiest = grid.solve(*powers(day, int(day.load_kw.sum(axis=1).argmax())))
    assert found["v_min_pu"]["value"] <= grid.v_pu(busiest.v).min() + 1e-9
    assert found["unbalance"]["value"] >= grid.unbalance(busiest.v).max() - 1e-9
    told = call("validate", circuit.parent / "small", "--power-flow").stdout
    assert "- Largest loading of a phase: " in told and "phase" in found["v_min_pu"]["at"]


@pytest.mark.daily
def test_plans_keep_every_phase_of_the_former_and_every_node(circuit: Path, day: Scenario) -> None:
    options = RunOptions(horizon_h=1.0).on(day)
    # In islands OpenDSS has its buses in another order then.
    off = tuple(replace(row, island="no") for row in day.phases.shunts)
    evening = replace(full(day), phases=replace(day.phases, shunts=off)).between(16, 19)
    run = Day(evening, options)
    trajectory = run.run(make_controller(evening, options))
    steps = trajectory.steps
    dark = steps["outage"].to_numpy(bool)
    kva = former_kva(trajectory)
    assert dark.tolist() == [True, True, False]
    assert kva[dark].max() <= phase_kva(evening) * 0.9 + 1.0
    assert (steps["shed_kw"] == 0.0).all()
    assert steps["v_error_pu"].max() < 1e-4
    figures = phase_figures(trajectory)
    assert 0.0 < figures["loading_max"] < 1.0 and "transformer" in figures["loading_at"]
    assert [row.what for row in limit_rows(trajectory)][2].startswith("Largest loading")
    fuller = replace(trajectory, steps=steps.assign(loading_max=1.2))
    assert any("A phase above its rating in 3 steps" in words for words in findings(fuller))
    assert figures["former_phase_rating_kva"] == pytest.approx(phase_kva(evening))
    assert figures["former_phase_max_kva"] == pytest.approx(kva[dark].max())
    assert figures["node_steps_outside_ac"] == 0
    nodes = trajectory.nodes
    assert nodes["v_ac_pu"].between(0.94, 1.06).all()
    assert_as_in_opendss(trajectory, circuit)
    explained = explain_day(trajectory)
    off = explained.explanations[explained.explanations["action"] == "not_served"]
    assert "phase" in set(off["driver"])
    assert off["words"].str.contains("phase [abc] of be").any()
    assert "phase rating" in " ".join(who_and_why(explained))
    check_price_of_a_phase(trajectory)


class Asks:
    """A controller with the same set-points in every step."""

    def __init__(self, day: Scenario, plan: Decision) -> None:
        self.day = day
        self.decision = plan

    def horizon_steps(self, t0: int) -> range:
        """The step alone."""
        return range(t0, t0 + 1)

    def decide(self, observation: Observation) -> Decision:
        """The set-points."""
        return self.decision


@pytest.mark.daily
@pytest.mark.parametrize("former", ["be", "g0"])
def test_vehicles_rooms_and_sets_are_those_of_opendss(
    circuit: Path, day: Scenario, former: str
) -> None:
    rooms, fuel = homes("cb", p_max_kw=40.0), {"tank_litres": 900.0, "fuel_level_litres": 900.0}
    sets = gensets(bus="m", p_min_kw=0.0, p_max_kw=300.0, only_in_outage=False, **fuel)
    sets = replace(sets, grid_forming=sets.id == former, power_factor=np.array([0.5]))
    vehicles = chargers(bus=["n"], p_charge_kw=60.0)
    rows = [
        PhaseConnection(name, bus, coils, kv)
        for name, bus, coils, kv in (
            ("h0", "n", "b", 2.4), ("g0", "m", "a b c", 2.4), ("k0", "n", "bc", 4.16)
        )
    ]  # fmt: skip
    assert day.phases
    phases = replace(day.phases, connections=(*day.phases.connections, *rows))
    b = day.batteries
    full = replace(b, soc_initial=b.soc_max, grid_forming=b.id == former)
    parts = {"thermal_loads": rooms, "gensets": sets, "chargers": vehicles, "batteries": full}
    more = plugged_in(replace(day, phases=phases, **parts).between(10, 14), (0.0, 4.0))
    wanted = {"thermal_loads": 40.0, "gensets": -150.0, "chargers": 60.0}
    on = np.isin(day.customers.id, ["cb", "cd"])
    plan = asked(more, wanted, served=on, curtailed_kw=1e3)
    run = Day(more, RunOptions(mode="physical")).run(Asks(more, plan))
    assert (run.gensets["p_kw"] > 100.0).all() and (run.vehicles["p_kw"] > 0.0).any()
    assert (run.steps["former"][run.steps["outage"]] == former).all()
    assert_as_in_opendss(run, circuit)


def check_price_of_a_phase(trajectory: Trajectory) -> None:
    """One more kVA on all phases of the former buys what their shadow prices add up to."""
    windows = Windows(trajectory)
    model = ShadowPriceModel(windows.site, windows.seen(0).n_steps, windows.beyond)
    window = windows.seen(0)
    held = windows.held(0, window.n_steps)
    terms = PricedTerms(1.0, 0.0, windows.site.weights.lambda_curt)
    phased = window.phased
    values = {}
    for change in (-0.01, 0.0, 0.01):
        room = phased.room_kva + change * (np.arange(window.n_steps) == 0)[:, None]
        other = replace(window, phased=replace(phased, room_kva=room))
        answer = price_window(model, other, held, terms)
        assert answer is not None
        values[change] = answer
    slope = (values[0.01].value - values[-0.01].value) / 0.02
    assert values[0.0].prices.former_phase.sum() == pytest.approx(slope, rel=1e-3)
    assert slope > 0.0


@pytest.mark.daily
def test_currents_of_phases_stay_within_ratings(day: Scenario) -> None:
    assert day.phases
    lines = tuple(replace(line, i_max_a=100.0) for line in day.phases.lines)
    late = replace(day, phases=replace(day.phases, lines=lines)).between(18, 20)
    reported = run_day(late.between(0, 1), RunOptions(horizon_h=0.0, ratings="report"))
    assert reported.steps["loading_max"].min() > 1.5
    kept = run_day(late, RunOptions(horizon_h=1.0, ratings="limit"))
    shown = Run(kept, {})
    (table,) = (part.of(shown).html for part in SECTIONS if part.key == "network")
    assert "The fullest phases" in table and "line from r to m, phase" in table
    assert "phase a and ab" in chart_of(kept, "by_phase").svg()
    assert "; phases a, b and c: " in step_states(kept)["info"][0]
    assert kept.steps["loading_max"].between(0.9, 1.0).all()
    assert kept.customers["served"].mean() > 0.5
    told = explain_day(kept)
    off = told.explanations[told.explanations["action"] == "not_served"]
    assert (off["binding"] == "rating").all()
    assert off["words"].str.contains("the line from r to m, phase").any()
    assert "line_rating" in set(told.shadow_prices["constraint"])


class Everyone:
    """All customers on in an island, whatever its former can carry."""

    def __init__(self, inner: Any) -> None:
        self.inner = inner

    def horizon_steps(self, t0: int) -> range:
        return self.inner.horizon_steps(t0)

    def decide(self, observation: Observation) -> Decision:
        found = self.inner.decide(observation)
        served = np.ones_like(found.dispatch.served)
        return replace(found, dispatch=replace(found.dispatch, served=served))


@pytest.mark.daily
def test_an_island_sheds_until_no_phase_of_its_former_is_beyond_its_rating(day: Scenario) -> None:
    evening = full(day).between(16, 17)
    options = RunOptions(horizon_h=0.0).on(evening)
    found = Day(evening, options).run(Everyone(make_controller(evening, options)))
    assert found.steps["shed_kw"].item() > 0.0
    assert former_kva(found).max() <= phase_kva(evening) + 1e-3
    on = found.customers["served"].to_numpy(bool)
    assert on[found.customers["tier"] == "critical"].all() and not on.all()


def test_other_batteries_discharge_before_an_island_sheds_by_phase(day: Scenario) -> None:
    """All customers are on, batteries rest: what the former lacks others give, phase by phase."""
    night = replace(full(day), pv_kw=0.0 * day.pv_kw).between(16, 17)
    for share, n_on in ((0.2, 5), (0.3, 5), (0.5, 3), (0.8, 0)):
        island = replace(night, load_kw=share * night.load_kw, grid_limit_kw=np.zeros(1))
        found = World(island, RunOptions(horizon_h=0.0)).obey(0, [])
        assert int(found.customers["served"].sum()) >= n_on, share
        assert not found.steps["dark_reason"]
        kva = max(found.steps[f"former_{phase}_kva"] for phase in "abc")
        assert kva <= phase_kva(night) + 1e-3


def test_an_island_without_a_battery_of_three_phases_is_dark_in_plans_too(day: Scenario) -> None:
    assert day.phases
    single = [replace(row, coils="a") if row.id == "be" else row for row in day.phases.connections]
    assert any(row.id == "be" and row.coils == "a" for row in single)
    lone = np.array([name == "be" for name in day.batteries.id])
    batteries = replace(day.batteries, grid_forming=np.zeros(len(lone), dtype=bool))
    phases = replace(day.phases, connections=tuple(single))
    island = replace(day, phases=phases, batteries=batteries).between(13, 14)
    assert "No battery that is to form a grid has three phases" in darkness(island)
    assert "phase_connections.csv" in darkness(island)
    assert former_words(island) == ""
    options = RunOptions(horizon_h=0.0).on(island)
    decided = make_controller(island, options).decide(
        Day(island, options).observe(make_controller(island, options), 0)
    )
    assert not decided.dispatch.served.any()


class Rule:
    """What is decided if no solver has an answer."""

    def __init__(self, day: Scenario) -> None:
        self.site = Site.of(day)
        self.tiers = list(day.tiers)

    def horizon_steps(self, t0: int) -> range:
        return range(t0, t0 + 1)

    def decide(self, observation: Observation) -> Decision:
        plan = rule_dispatch(StepState.of(self.site, observation, "lossless"), self.tiers)
        return Decision(plan, 0, SolveInfo(status="rule"), fallback="rule")


@pytest.mark.daily
def test_the_rule_serves_in_an_island_what_every_phase_carries(day: Scenario) -> None:
    island = full(day).between(12, 15)
    options = RunOptions(horizon_h=0.0).on(island)
    found = Day(island, options).run(Rule(island))
    assert (found.steps["dark_reason"] == "").all()
    assert (found.steps["shed_kw"] == 0.0).all()
    assert former_kva(found).max() <= phase_kva(island) + 0.1
    assert found.customers.groupby("time")["served"].any().all()


@pytest.mark.parametrize("share", [10.0, 1.0, 0.2])
def test_the_rule_needs_few_power_flows_and_serves_what_it_would_one_by_one(
    day: Scenario, share: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With a former that carries everyone, and with smaller ones."""
    b = full(day).batteries
    factor = np.where(b.formers, share, 1.0)
    sizes = {each: getattr(b, each) * factor for each in ("energy_kwh", "p_max_kw", "s_max_kva")}
    island = replace(day, batteries=replace(b, **sizes)).between(12, 13)
    state = first_state(island)
    order = service_order(state, list(island.tiers))
    kept: list[int] = []
    for customer in order:
        tried = served_by_phase(state, [np.array([*kept, customer])]).served[0]
        kept += [customer] if tried[[*kept, customer]].all() else []
    flows: list[int] = []
    solved = PhasedModel.solved

    def counted(model: PhasedModel, source: int, *drawn: Any) -> PhasedResult | None:
        flows.append(source)
        return solved(model, source, *drawn)

    monkeypatch.setattr(PhasedModel, "solved", counted)
    served = served_by_phase(state, [order]).served[0]
    assert np.flatnonzero(served).tolist() == sorted(kept)
    assert served.all() == (share == 10.0)
    assert share < 10.0 or len(flows) < len(order)


def test_the_rule_serves_the_largest_worth_of_a_first_tier_that_power_suffices_for(
    day: Scenario,
) -> None:
    """Of two on three phases the smaller one is worth more per kW, but less, and not both fit."""
    names = [str(name) for name in day.customers.id]
    large, small = (names.index(next(n for n in names if n.endswith(end))) for end in "ed")
    weight = np.full(len(names), 0.01)
    weight[[large, small]] = 1.5, 1.0
    customers = replace(day.customers, tier=["critical"] * len(names), weight=weight)
    island = replace(full(day), customers=customers).between(12, 13)
    state = first_state(island)
    dark = replace(state.now, pv_kw=0.0 * state.now.pv_kw, load_kw=np.zeros((1, len(names))))
    state = replace(state, now=dark)
    former_kw = state.discharge_max_kw[island.batteries.formers].sum()
    state.load_kw[[large, small]] = 0.8 * former_kw, 0.4 * former_kw
    served = rule_dispatch(state, list(island.tiers)).served[0]
    assert served[[large, small]].tolist() == [True, False]


@pytest.mark.daily
def test_few_of_the_limits_that_bind_everywhere_are_rows_from_the_start(tmp_path: Path) -> None:
    """A plan near the feeder without control has all of its voltages at limits that give way."""
    file = tmp_path / "low.dss"
    lines = [
        f"new line.s{at} bus1=e{at or ''} bus2=e{at + 1} linecode=three length=0.01 units=km\n"
        for at in range(40)
    ]
    file.write_text(CIRCUIT.replace("set voltagebases", "".join(lines) + "set voltagebases"))
    day = phased_day(file)
    two = day.between(18, 20)
    options = RunOptions(horizon_h=1.0).on(two)
    observation = Day(two, options).observe(make_controller(two, options), 0)
    site = Site.of(two)
    planner, model = ConvergedPlanner(WindowSolver(site)), phased_model(site)
    data = planner.begun(observation)[2]
    plan = planner.solver.solve(data).dispatch
    phased = data.phased
    there = phased.u_offset + model.linear(data, *model.drawn(data, plan))[0]
    data = replace(data, phased=replace(phased, u_min=there))
    bound = near_to(site, data, plan).phased.bound.sum(axis=2)
    assert (bound[:, 0] >= 3 * MOST_BINDING).all()
    assert (bound[:, 0] <= len(model.by_phase) * MOST_BINDING).all()


def test_phases_are_part_of_the_digest(day: Scenario) -> None:
    assert scenario_digest(day) != scenario_digest(replace(day, phases=None))


BANKED = CIRCUIT.replace(
    "new line.l1", "new capacitor.one bus1=m.1 phases=1 kvar=60 kv=2.4\nnew line.l1", 1
)
"""With a capacitor on one phase: 110 kvar on it, less than the 216 kVA of the former together."""


@pytest.fixture(scope="module")
def banked(tmp_path_factory: pytest.TempPathFactory) -> Scenario:
    """A day of that feeder, its batteries full."""
    return full(day_of(BANKED, tmp_path_factory.mktemp("banked")))


def test_capacitors_are_switched_by_phase_in_islands(banked: Scenario) -> None:
    """The smaller one stays: a third of the former's rating holds it alone."""
    assert banked.phases
    left = {(row.bus, row.coils): row.island for row in banked.phases.shunts}
    assert left == {("m", "a"): "yes", ("e", "a b c"): "no"}
    assert any("a third of the 216 kVA on one phase" in note for note in banked.source.notes)
    assert held_capacitors(banked) == "" and "bus e" in held_capacitors(all_on(banked))


def all_on(day: Scenario) -> Scenario:
    """The day with all of its capacitors on in islands."""
    assert day.phases
    shunts = tuple(replace(row, island="yes") for row in day.phases.shunts)
    network = replace(day.network, island=np.ones(day.network.n_buses, dtype=bool))
    return replace(day, network=network, phases=replace(day.phases, shunts=shunts))


@pytest.mark.parametrize("kept", [False, True])
def test_an_island_whose_answer_fails_holds_capacitors_of_one_phase(
    banked: Scenario, kept: bool
) -> None:
    """Batteries on that phase take what its third of the former does not, where all stay on."""
    island = (all_on(banked) if kept else banked).between(13, 14)
    options = RunOptions(horizon_h=0.0, isolate=False)
    run = run_day(island, options, faults=FaultPlan({0: SolverOutage("killed")}))
    assert run.steps["fallback"].tolist() == ["rule"]
    assert run.steps["dark_reason"].tolist() == [""] and run.customers["served"].any()
    assert former_kva(run).max() <= phase_kva(island) + 0.1


@pytest.mark.daily
def test_an_island_whose_capacitors_no_former_holds_is_planned_dark(banked: Scenario) -> None:
    """The hour before the outage keeps its plan, with no voltage limit widened."""
    day, b = all_on(banked), banked.batteries
    assert day.phases
    larger = tuple(replace(row, q_kvar=6.0 * row.q_kvar) for row in day.phases.shunts)
    little = np.where(b.grid_forming, 1.0, 0.02)
    small = replace(b, s_max_kva=little * b.s_max_kva, p_max_kw=little * b.p_max_kw)
    day = replace(day, phases=replace(day.phases, shunts=larger), batteries=small).between(11, 13)
    run = run_day(day, RunOptions(horizon_h=1.0, mode="physical", isolate=False))
    assert run.steps["fallback"].tolist() == ["none", "none"]
    assert run.steps["status"].tolist() == ["optimal", "blacked_out"]
    assert run.by_step("customers", "served").any(axis=1).tolist() == [True, False]


@pytest.mark.daily
def test_an_island_serves_what_lies_behind_regulators(tmp_path: Path) -> None:
    """They are at nominal taps there, in OpenDSS too: no voltage leaves its limits."""
    day = day_of(REGULATED, tmp_path)
    assert day.phases
    units = day.phases.transformers
    assert max(unit.to_tap for unit in units) > 1.08 and {unit.island_tap for unit in units} == {
        1.0
    }
    b = day.batteries
    near = b.id == "bnear"
    batteries = replace(
        b,
        grid_forming=near,
        s_max_kva=np.where(near, 2000.0, b.s_max_kva),
        p_max_kw=np.where(near, 1800.0, b.p_max_kw),
        energy_kwh=np.where(near, 4000.0, b.energy_kwh),
        soc_initial=np.where(near, b.soc_max, b.soc_min),
    )
    island = replace(day, batteries=batteries, pv_kw=0.0 * day.pv_kw).between(18, 20)
    island = replace(island, grid_limit_kw=np.zeros(2))
    run = run_day(island, RunOptions(horizon_h=2.0, isolate=False))
    assert run.nodes["v_ac_pu"].between(day.network.v_min_ac_pu, day.network.v_max_ac_pu).all()
    assert (run.customers.groupby("time")["served"].sum() >= 4).all()
    assert recheck_run(run, tmp_path / "circuit.dss").voltages["difference_pu"].abs().max() < 1e-6
