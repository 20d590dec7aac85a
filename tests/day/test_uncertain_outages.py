"""What a run is told of outages: no more than was seen, and with certainty exactly what is known."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from experiments.studies.faults import drawn_faults
from tests.support.refusals import refusal
from vppres.core.errors import InputError
from vppres.day.options import RunOptions
from vppres.day.outages import believed_outages
from vppres.day.run_files import read_run
from vppres.day.simulate import run_day
from vppres.day.trajectory import Trajectory
from vppres.explain.day import explain_day
from vppres.explain.windows import Windows
from vppres.kinds.export.physics import Export
from vppres.live.controller import Controller
from vppres.live.measurement import Measurement
from vppres.report.plots.figures import figure_names, outage_belief
from vppres.report.run_folder import write_run
from vppres.scenario.outage_warnings import OutageStatistics, OutageWarning
from vppres.scenario.scenario import ControllerDefaults, Scenario
from vppres.solve.ladder import WindowSolver

HOUR = pd.Timedelta(hours=1)
NEVER = OutageStatistics(saifi_per_year=0.0)
OFTEN = OutageStatistics(saifi_per_year=300.0, caidi_h=2.0)
OF_BELIEFS = ("stored_value_gbp_per_kwh", "outage_messages")
TIMES = ("solve_s", "solver_s", "compilations")


def records(run: Trajectory, steps: int | None = None) -> dict[str, pd.DataFrame]:
    """All tables of a run, or of its first steps, without times and what only beliefs have."""
    found = {}
    for name, table in run.tables.items():
        left = [c for c in table if c not in (*TIMES, *OF_BELIEFS, "phase")]
        rows = len(table) // len(run.steps)
        found[name] = table[left] if steps is None else table[left].iloc[: steps * rows]
    return found


def same(one: Trajectory, other: Trajectory, steps: int | None = None) -> bool:
    """Whether two runs have the same record, to the last bit."""
    tables = records(one, steps)
    return all(table.equals(records(other, steps)[name]) for name, table in tables.items())


def certainly(tiny: Scenario) -> Scenario:
    """The tiny day with its outage announced for certain, and no other."""
    onset = tiny.grid.times[3]
    warned = OutageWarning(tiny.grid.start, onset_likely=onset, duration_p50_h=2.0)
    return replace(tiny, warnings=(warned,), outage_statistics=NEVER)


@pytest.mark.parametrize(
    ("mode", "exports"), [("paper", False), ("paper", True), ("physical", False)]
)
def test_certainty_is_what_is_known_to_the_last_bit(
    tiny: Scenario, mode: str, exports: bool
) -> None:
    day = certainly(tiny)
    if exports:
        more = {"export_limit_kw": np.array(30.0), "export_price_gbp_per_kwh": np.array(0.1)}
        day = replace(day, **more)
    options = RunOptions(horizon_h=2.0, mode=mode)
    known = run_day(day, options)
    for kind in ("belief",) if exports else ("belief", "likely"):
        assert same(known, run_day(day, replace(options, outages=kind))), kind


def random_day(tiny: Scenario, seed: int) -> Scenario:
    """The tiny day with an outage, messages and statistics of a seed."""
    rng = np.random.default_rng([seed, 5])
    start, length = rng.integers(1, 5), rng.integers(1, 4)
    limit_kw = np.full(tiny.grid.n_steps, np.inf)
    limit_kw[start : start + length] = 0.0
    messages = []
    for hours in np.sort(rng.uniform(0.0, 5.0, 3)):
        likely = tiny.grid.start + float(rng.uniform(hours, 6.0)) * HOUR
        spread = float(rng.uniform(0.2, 2.0)) * HOUR
        messages.append(
            OutageWarning(
                tiny.grid.start + float(hours) * HOUR,
                onset_earliest=likely - spread,
                onset_likely=likely,
                onset_latest=likely + spread,
                probability=float(rng.choice([0.0, 0.4, 0.9])),
                duration_p10_h=1.0,
                duration_p50_h=2.0,
                duration_p90_h=4.0,
            )
        )
    return replace(
        tiny,
        grid_limit_kw=limit_kw,
        warnings=tuple(messages),
        outage_statistics=OFTEN,
        export_limit_kw=np.array(float(rng.choice([0.0, 20.0]))),
    )


def with_another_future(day: Scenario, step: int, seed: int) -> Scenario:
    """The same up to a step, that one included; other limits and messages behind it."""
    rng = np.random.default_rng([seed, step, 6])
    limit_kw = day.grid_limit_kw.copy()
    limit_kw[step + 1 :] = rng.choice([0.0, np.inf, 40.0], len(limit_kw) - step - 1)
    now = day.grid.times[step]
    issued = [w for w in day.warnings if w.issued_at <= now]
    later = OutageWarning(now + 0.5 * HOUR, onset_likely=now + 2 * HOUR, duration_p50_h=1.0)
    return replace(day, grid_limit_kw=limit_kw, warnings=(*issued, later))


@pytest.mark.parametrize(
    ("controller", "kind"),
    [
        # By day with faults, below.
        *(pytest.param("mpc", k, marks=pytest.mark.nightly) for k in ("belief", "likely", "none")),
        ("full-horizon", "likely"),
        ("reserve", "likely"),
        pytest.param("reserve", "none", marks=pytest.mark.nightly),
    ],
)
def test_nothing_that_is_not_seen_changes_a_decision(
    tiny: Scenario, nightly: bool, controller: str, kind: str
) -> None:
    leaks = []
    for seed in range(2 if nightly else 1):
        day = random_day(tiny, seed)
        options = RunOptions(outages=kind, controller=controller, horizon_h=3.0)
        run = run_day(day, options)
        for step in (0, 3):
            other = run_day(with_another_future(day, step, seed), options)
            if not same(run, other, step + 1):
                leaks.append((seed, step))
    assert not leaks


@pytest.mark.parametrize("kind", ["likely", "belief", "none"])
def test_guard_and_fallbacks_see_no_more(tiny: Scenario, kind: str) -> None:
    """Solvers that fail, readings that are missing, batteries that trip: nothing falls back on
    what is not known."""
    leaks = []
    fallbacks = set()
    for seed in range(2):
        day = random_day(tiny, seed)
        faults = drawn_faults(tiny, seed)
        options = RunOptions(outages=kind, horizon_h=3.0, protect_critical=True)
        run = run_day(day, options, faults=faults)
        fallbacks |= set(run.steps["fallback"])
        other = run_day(with_another_future(day, 2, seed), options, faults=faults)
        if not same(run, other, 3):
            leaks.append(seed)
    assert not leaks
    assert fallbacks > {"none"}


def test_known_does_see_what_comes(tiny: Scenario) -> None:
    """The test above can fail: with known outages the future changes decisions."""
    day = random_day(tiny, 0)
    other = with_another_future(day, 2, 1)
    options = RunOptions(horizon_h=3.0)
    assert not same(run_day(day, options), run_day(other, options), 3)


def test_every_window_is_certified_and_worth_is_recorded(tiny: Scenario) -> None:
    for seed in range(3):
        day = random_day(tiny, seed)
        run = run_day(day, RunOptions(outages="belief"))
        assert (run.steps["status"] == "optimal").all()
        assert (run.steps["fallback"] == "none").all()
        worth = run.steps["stored_value_gbp_per_kwh"].to_numpy(float)
        assert np.isfinite(worth).all()
        dark = run.steps["outage"].to_numpy(bool)
        assert worth[dark].max(initial=0.0) >= worth[~dark].min()
    assert "stored_value_gbp_per_kwh" not in run_day(tiny, RunOptions()).steps


def test_batteries_are_charged_for_what_may_come(tiny: Scenario) -> None:
    """Nothing comes; who believes it may has bought energy by noon, and who does not has none."""
    day = replace(tiny, grid_limit_kw=np.full(6, np.inf), price_gbp_per_kwh=np.full(6, 0.3))
    warned = OutageWarning(
        day.grid.start,
        onset_earliest=day.grid.times[2],
        onset_likely=day.grid.times[3],
        onset_latest=day.grid.times[4],
        probability=0.4,
        duration_p50_h=2.0,
    )
    day = replace(day, warnings=(warned,), outage_statistics=NEVER)
    stored = {
        kind: run_day(day, RunOptions(outages=kind)).batteries["soc_end"].to_numpy()[2:4].mean()
        for kind in ("likely", "belief")
    }
    assert stored["belief"] > 0.8
    assert stored["likely"] < 0.4


@pytest.mark.daily
@pytest.mark.parametrize(
    "controller", ["mpc", pytest.param("full-horizon", marks=pytest.mark.nightly), "reserve"]
)
def test_a_guess_takes_nobody_off_the_grid(tiny: Scenario, controller: str) -> None:
    """An import limit that leaves little to charge with while homes are on.

    A certain outage may; the rule of the reserve puts customers before batteries then too.
    """
    limit_kw = np.full(6, 160.0)
    day = replace(tiny, grid_limit_kw=limit_kw, pv_kw=np.zeros((6, 2)), outage_statistics=NEVER)
    off = {}
    for probability in (0.7, 1.0):
        warned = OutageWarning(
            day.grid.start,
            onset_likely=day.grid.times[3],
            probability=probability,
            duration_p50_h=2.0,
        )
        run = run_day(
            replace(day, warnings=(warned,)).between(0, 5),
            RunOptions(outages="likely", horizon_h=2.0, controller=controller),
        )
        off[probability] = int((~run.customers["served"]).sum())
        assert (run.steps["fallback"] == "none").all()
    assert off[0.7] == 0
    assert (off[1.0] > 0) is (controller != "reserve")


def test_what_is_left_is_worth_what_a_cheap_night_fills_again(tiny: Scenario) -> None:
    """The lowest price of the day with the loss of charging, not that of the evening's hours."""
    day = replace(
        tiny,
        grid_limit_kw=np.full(6, np.inf),
        price_gbp_per_kwh=np.array([0.1, 0.1, 0.5, 0.5, 0.5, 0.5]),
        outage_statistics=OutageStatistics(saifi_per_year=1e-4),
    )
    run = run_day(day, RunOptions(outages="belief"))
    worth = run.steps["stored_value_gbp_per_kwh"].to_numpy(float)
    assert worth[-1] == pytest.approx(0.1 / day.batteries.eta_charge[0], rel=1e-6)


@pytest.mark.parametrize(
    ("controller", "kind"),
    [("full-horizon", "belief"), ("idle", "belief"), ("perfect", "likely"), ("perfect", "none")],
)
def test_what_has_no_meaning_is_refused(tiny: Scenario, controller: str, kind: str) -> None:
    with pytest.raises(InputError, match="has no meaning for the controller"):
        run_day(tiny, RunOptions(controller=controller, outages=kind))


def test_a_horizon_within_a_step_is_refused(tiny: Scenario) -> None:
    assert refusal(run_day, tiny, RunOptions(horizon_h=0.5)) == (
        "options, horizon_h = 0.5: is shorter than a step of 1 h. Give 1 or more, or 0 for the present "
        "step alone."
    )


def test_a_scenario_may_ask_for_it(tiny: Scenario) -> None:
    asked = replace(tiny, controller=ControllerDefaults(mode="paper", outages="none"))
    assert RunOptions().on(asked).outages == "none"
    assert RunOptions(outages="known").on(asked).outages == "known"


def test_export_is_believed_like_import(tiny: Scenario) -> None:
    day = replace(tiny, export_limit_kw=np.array(10.0))
    told = Export.of(day, slice(2, 5), np.array([np.inf, 0.0, np.inf]))
    assert told.limit_kw.tolist() == [10.0, 0.0, 10.0]
    assert Export.of(tiny, slice(0, 1), np.array([np.inf])) is None


@pytest.mark.parametrize("kind", ["belief", "likely", "none"])
def test_a_live_controller_decides_as_a_run_does(tiny: Scenario, kind: str) -> None:
    """Messages come as they are issued; of the limits it is told those of the step alone."""
    day = random_day(tiny, 1)
    options = RunOptions(outages=kind, horizon_h=3.0, isolate=False)
    run = run_day(day, options)
    blind = replace(day, warnings=(), grid_limit_kw=np.full(day.grid.n_steps, np.inf))
    controller = Controller.of(blind, options)
    soc = run.batteries["soc_start"].to_numpy().reshape(-1, 2)
    wrong = []
    for t, now in enumerate(day.grid.times):
        issued = [w for w in day.warnings if w.issued_at <= now]
        controller.warn(*(w for w in issued if w not in controller.scenario.warnings))
        told = Measurement(
            now,
            soc=dict(zip(day.batteries.id, soc[t], strict=True)),
            grid_limit_kw=float(day.grid_limit_kw[t]),
        )
        done = controller.step(told)
        rows = run.batteries.iloc[2 * t : 2 * t + 2]
        power = (rows["charge_kw"] - rows["discharge_kw"]).to_numpy()
        if not np.allclose(done.batteries["p_kw"], power, atol=1e-3):
            wrong.append((t, done.batteries["p_kw"].tolist(), power.tolist()))
        assert ("stored_value_gbp_per_kwh" in done.solve) == (kind == "belief")
    assert not wrong


def rationed_day(tiny: Scenario) -> Scenario:
    """Hours without grid, and a battery that does not last for them."""
    warned = OutageWarning(
        tiny.grid.start,
        onset_earliest=tiny.grid.times[0],
        onset_likely=tiny.grid.times[1],
        onset_latest=tiny.grid.times[2],
        probability=0.9,
        duration_p10_h=2.0,
        duration_p50_h=4.0,
        duration_p90_h=6.0,
    )
    limit_kw = np.array([np.inf, np.inf, 0.0, 0.0, 0.0, 0.0])
    return replace(tiny, grid_limit_kw=limit_kw, warnings=(warned,), outage_statistics=OFTEN)


def test_rationing_is_explained_by_what_a_kwh_is_worth_later(tiny: Scenario) -> None:
    run = explain_day(run_day(rationed_day(tiny), RunOptions(outages="belief")))
    words = run.explanations["words"]
    rationed = words[words.str.contains("energy saved for later; 1 kWh is worth")]
    assert len(rationed) > 0
    later, now = zip(*rationed.str.findall(r"£([0-9.]+)").tolist(), strict=True)
    assert (np.array(later, dtype=float) >= np.array(now, dtype=float)).all()
    assert not words.str.contains("neither shadow prices nor the record").any()


@pytest.mark.nightly
def test_what_is_kept_is_said_with_numbers_that_a_second_solve_confirms(tiny: Scenario) -> None:
    run = explain_day(run_day(rationed_day(tiny), RunOptions(outages="belief")))
    believed = believed_outages(run.scenario, run.options)
    words = run.explanations[run.explanations["item"] == "step"]["words"].tolist()
    windows = Windows(run)
    b, c = tiny.batteries, tiny.customers
    other = WindowSolver(windows.site, method="monolithic")
    told = [t for t in range(6) if "energy is kept until" in words[t]]
    assert {1, 2, 3} <= set(told)
    for t in told:
        found = re.search(
            r"([0-9]+)% of the usable energy is kept until (\S+) because .* (\S+) with ([0-9]+)%; it "
            r"costs (?:£([0-9]+)|nothing) in this step; it covers hospital for ([0-9.]+) h",
            words[t],
        )
        share, end, until, chance, gbp, hours = found.groups()
        held = windows.recorded.done.soc[t + 1] - b.soc_min
        kwh = float(b.energy_kwh @ held)
        assert int(share) == round(100 * kwh / float(b.energy_kwh @ (b.soc_max - b.soc_min)))
        times = [f"{time:%H:%M}" for time in (*tiny.grid.times, tiny.grid.end)]
        assert end == times[t + 1]
        assert int(chance) == round(100 * believed[t, times.index(until) - 1])
        needed = float(run.scenario.load_kw[t:, 0].mean())
        assert float(hours) == pytest.approx(kwh * float(b.eta_discharge[0]) / needed, rel=0.05)
        # The same step without a value of what is left.
        window = windows.seen(t)
        alone = other.solve(replace(window.first(1), stored_value=None)).dispatch
        served = windows.recorded.done.served[t]
        lost = float((alone.served[0].astype(float) - served) @ c.weight)
        price = float(tiny.price_gbp_per_kwh[t])
        imported = 0.0 if run.scenario.outage[t] else windows.recorded.done.p_grid_kw[t]
        costs = window.stored_value.gbp_per_service * lost
        costs += price * (imported - float(alone.p_grid_kw[0]))
        assert float(gbp or 0.0) == pytest.approx(max(costs, 0.0), abs=0.6)


@pytest.mark.parametrize("seed", [1, 3])
def test_a_step_and_its_batteries_tell_the_same_worth(tiny: Scenario, seed: int) -> None:
    run = explain_day(run_day(random_day(tiny, seed), RunOptions(outages="belief", horizon_h=3.0)))
    told = run.explanations[run.explanations["item"].isin(["step", "battery"])]
    worth = told["words"].str.extract(r"stored kWh is worth (-?£[\d.]+)")[0]
    counts = worth.groupby(told["time"]).agg(["count", "nunique"])
    assert (counts["count"] > 1).any()
    assert (counts["nunique"] <= 1).all()


def test_certain_windows_of_a_belief_are_explained_too(tiny: Scenario) -> None:
    run = explain_day(run_day(certainly(tiny), RunOptions(outages="belief", horizon_h=2.0)))
    known = explain_day(run_day(certainly(tiny), RunOptions(horizon_h=2.0)))
    assert run.explanations["driver"].tolist() == known.explanations["driver"].tolist()


@pytest.mark.nightly
def test_the_report_shows_the_belief_beside_what_came(tiny: Scenario, tmp_path: Path) -> None:
    run = run_day(rationed_day(tiny), RunOptions(outages="belief"))
    believed = believed_outages(run.scenario, run.options)
    assert np.diagonal(believed).tolist() == run.scenario.outage.astype(float).tolist()
    assert np.isnan(believed[np.tril_indices(6, -1)]).all()
    figure = outage_belief(run)
    curve = next(curve for curve in figure.panels[0].curves if curve.name == "1 h before")
    assert curve.values[1:] == pytest.approx(np.diagonal(believed, 1))
    write_run(run, tmp_path / "run")
    page = (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
    assert "Outage forecasts and outcomes" in page
    assert "2, 4, 6" in page
    read = read_run(tmp_path / "run")
    assert read.scenario.warnings == run.scenario.warnings
    known = run_day(tiny, RunOptions())
    assert "outage_belief" not in figure_names(known)
