"""How close a feeder is to its source: voltages against the source's own AC power flow.

Three states are compared: no load, the source as it is given, and the hours of a scenario in which
demand or generation are largest. What is not the same is stated with its size.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.arrays import Floats, Names
from vppres.core.errors import InputError, VerificationError
from vppres.core.text import named
from vppres.core.units import kw_to_mw, mw_to_kw
from vppres.feeders.feeder import Deviation, ImportedFeeder
from vppres.feeders.net.elements import NetCase, label, supplied
from vppres.kinds.table import units_of
from vppres.physics.phased_sources import assets_of, drawn_uncontrolled
from vppres.physics.powerflow import ACPowerFlow, ACResult
from vppres.scenario.network import BusId, Network
from vppres.scenario.scenario import Scenario
from vppres.scenario.source import EXACT_PU, SourceDeviation

# Impedances of next to nothing, as OpenDSS has in its switches, leave no more than the latter.
TOLERANCES_MVA = (1e-9, 1e-5)
POWERS = ("load", "sgen", "gen", "storage", "motor", "asymmetric_load", "asymmetric_sgen")
LOSSES = ("line", "trafo", "trafo3w", "impedance", "shunt")
NOT_CONVERGED = (
    "The source's own AC power flow does not converge, so nothing says how close the feeder is to "
    "it. First check the units of its loads (MW; kW in OpenDSS) and lines."
)
NO_SOLUTION = (
    "The feeder's own power flow has no solution with the powers of the source, so nothing says "
    "how close it is to it."
)


class PandapowerFlow:
    """The power flow of a pandapower net without its own loads and generators.

    ``bus_in_net`` has a bus of the net for every bus of the feeder but its star points.
    """

    def __init__(self, net: Any, bus_in_net: Mapping[BusId, int]) -> None:
        import pandapower as pp

        self.net = copy.deepcopy(net)
        for table in POWERS:
            self.net[table]["in_service"] = False
        for power in ("ps_mw", "qs_mvar"):
            self.net.ward[power] = 0.0
        self.bus_in_net = dict(bus_in_net)
        self.loads = pp.create_loads(self.net, [*self.bus_in_net.values()], p_mw=0.0, q_mvar=0.0)

    def v_pu(
        self, buses: Names, p_kw: Floats, q_kvar: Floats, v_slack_pu: float | None = None
    ) -> dict[int, float] | None:
        """See :class:`vppres.feeders.feeder.SourceFlow`."""
        for column, values in (("p_mw", p_kw), ("q_mvar", q_kvar)):
            drawn = pd.Series(-kw_to_mw(values), buses).reindex([*self.bus_in_net])
            self.net.load.loc[self.loads, column] = drawn.to_numpy()
        if v_slack_pu is not None:
            self.net.ext_grid["vm_pu"] = v_slack_pu
        if not solve_source(self.net):
            return None
        return {int(bus): float(v) for bus, v in self.net.res_bus["vm_pu"].items()}


def solve_source(net: Any) -> bool:
    """Run a source's own power flow; whether it converged."""
    import pandapower as pp

    options = {"calculate_voltage_angles": False, "numba": False}
    for tolerance_mva, init in product(TOLERANCES_MVA, ("auto", "dc")):
        try:
            pp.runpp(net, init=init, tolerance_mva=tolerance_mva, **options)
        except (pp.LoadflowNotConverged, ArithmeticError, np.linalg.LinAlgError):
            continue
        return True
    return False


def deviation_of(net: Any, solved: bool, feeder: ImportedFeeder) -> Deviation | None:
    """The feeder as given, and without load, against a net that was solved."""
    if not solved:
        return None
    source = {int(bus): float(v) for bus, v in net.res_bus["vm_pu"].items()}
    losses_mw = sum(float(net[f"res_{table}"].filter(["pl_mw"]).sum().sum()) for table in LOSSES)
    losses_mw += float(net.res_switch.filter(["p_from_mw", "p_to_mw"]).sum().sum())
    shunts_mw = float(net.res_shunt["p_mw"].sum())
    shunts_mw += float((net.ward["pz_mw"] * net.res_ward["vm_pu"] ** 2).sum())
    return given_deviation(feeder, source, float(mw_to_kw(losses_mw + shunts_mw)))


def given_deviation(
    feeder: ImportedFeeder, source: Mapping[int, float] | None, losses_kw: float | None
) -> Deviation | None:
    """The feeder as given, and without load, against voltages and losses of its source."""
    if source is None or losses_kw is None:
        return None
    result = _as_given(feeder)
    if result is None:
        return None
    apart = _apart(feeder, result.v_pu, source)
    return Deviation(apart, losses_kw, result.losses_kw, no_load_pu(feeder))


def largest_difference(feeder: ImportedFeeder, source: Mapping[int, float]) -> float | None:
    """Largest difference from voltages of some buses of the source, with powers as given."""
    result = _as_given(feeder)
    return None if result is None or not source else _apart(feeder, result.v_pu, source)


def _as_given(feeder: ImportedFeeder) -> ACResult | None:
    """The feeder's power flow with the powers of its source."""
    try:
        return ACPowerFlow(feeder.network).solve(*feeder.injection)
    except VerificationError:
        return None


def source_deviation(feeder: ImportedFeeder, scenario: Scenario) -> SourceDeviation:
    """Differences in all three states; none is known where a power flow has no solution."""
    given = feeder.deviation
    if given is None:
        return SourceDeviation(opened_pu=feeder.opened_pu)
    worst_pu = worst_hour_pu(feeder, scenario)
    return SourceDeviation(given.no_load_pu, given.v_max_pu, worst_pu, feeder.opened_pu)


def told_deviation(feeder: ImportedFeeder, deviation: SourceDeviation) -> str:
    """How close the feeder is to its source, in a sentence or two."""
    given = feeder.deviation
    if given is None:
        return _unsolved(feeder)
    losses = f"Losses as given are {given.losses_kw:.3f} kW"
    return f"{deviation} {losses}, in the source {given.losses_source_kw:.3f} kW."


def _unsolved(feeder: ImportedFeeder) -> str:
    """Sentence on the power flow that has no solution, the feeder's or its source's."""
    return NO_SOLUTION if feeder.source_solves else NOT_CONVERGED


def told_causes(feeder: ImportedFeeder, deviation: SourceDeviation) -> Iterator[str]:
    """Causes of more than a trace of difference, or the reason why they are unknown."""
    largest = deviation.largest_pu
    if feeder.deviation is None:
        yield _unsolved(feeder)
    elif largest is not None and largest > EXACT_PU:
        yield f"Causes of the difference of {largest:.2g} pu: {_causes(feeder)}."


def _causes(feeder: ImportedFeeder) -> str:
    opened_pu = feeder.opened_pu or 0.0
    loops = [f"opened loops (--open-loops), {opened_pu:.2g} pu"] if opened_pu > EXACT_PU else []
    return "; ".join([*loops, *feeder.causes]) or "no single element of the source"


def check_deviation(feeder: ImportedFeeder, deviation: SourceDeviation, accepted: bool) -> None:
    """Refuse a feeder whose voltages are not the source's, unless that was accepted."""
    largest = deviation.largest_pu
    if accepted:
        return
    unsolved = feeder.phased is None and feeder.deviation is None and feeder.source_solves
    if unsolved or NO_SOLUTION in feeder.notes:
        words = "has no solution of its own power flow with the powers of the source"
    elif largest is not None and largest > EXACT_PU:
        words = f"has voltages up to {largest:.2g} pu away from the source's"
    else:
        return
    raise InputError.of(
        feeder.name,
        f"{words}. Causes: {_causes(feeder)}",
        "Accept that with --accept-deviation, or change the source.",
    )


def no_load_pu(feeder: ImportedFeeder) -> float | None:
    """Largest difference of a voltage without loads, generators and fixed demand."""
    none = np.zeros(feeder.network.n_buses)
    network = replace(feeder.network, p_fixed_kw=none, q_fixed_kvar=none)
    return _difference(feeder, network, none, none)


def worst_hour_pu(feeder: ImportedFeeder, scenario: Scenario) -> float | None:
    """Largest difference of a voltage in the steps of :func:`extreme_steps`.

    None where a power flow does not converge, or the source has none.
    """
    found = [
        _difference(feeder, scenario.network, p_kw, q_kvar)
        for p_kw, q_kvar in extreme_steps(scenario)
    ]
    known = [value for value in found if value is not None]
    return max(known) if len(known) == len(found) else None


def extreme_steps(scenario: Scenario) -> Iterator[tuple[Floats, Floats]]:
    """Injections (kW, kvar) of the steps with the largest and least demand and generation.

    All customers are served, all generators give what they can, vehicles and machines take what
    they can, and batteries rest.
    """
    load_kw = scenario.load_kw
    given_kw = scenario.pv_kw
    network = scenario.network
    at_customer = network.place(scenario.customers.bus)
    at_pv = network.place(scenario.pv.buses(scenario.customers))
    taken = [
        (network.place(units.buses(scenario.customers)), units.most_taken_kw(scenario))
        for units in units_of(scenario).values()
    ]
    for t in extreme_times(scenario):
        p_kw = at_pv @ given_kw[t] - at_customer @ load_kw[t]
        for place, most_kw in taken:
            p_kw = p_kw - place @ most_kw[t]
        q_kvar = -(at_customer @ (load_kw[t] * scenario.customers.q_per_p))
        yield p_kw, q_kvar


def extreme_steps_by_phase(scenario: Scenario) -> Iterator[tuple[int, Floats, Floats]]:
    """Steps of extreme demand and generation, and what each device draws in kW and kvar there."""
    usable_kw = np.minimum(scenario.pv_kw, scenario.pv.s_max_kva)
    load_kw, load_kvar, count = scenario.load_kw, scenario.load_kvar, len(assets_of(scenario))
    for t in extreme_times(scenario):
        yield t, *drawn_uncontrolled(load_kw[t], load_kvar[t], usable_kw[t], count)


def extreme_times(scenario: Scenario) -> list[int]:
    """Steps with the largest and least demand, in all and less generation."""
    load_kw = scenario.load_kw.sum(axis=1)
    for units in units_of(scenario).values():
        load_kw = load_kw + units.most_taken_kw(scenario).sum(axis=1)
    net_kw = load_kw - scenario.pv_kw.sum(axis=1)
    return sorted({int(each) for kw in (load_kw, net_kw) for each in (kw.argmax(), kw.argmin())})


def _difference(
    feeder: ImportedFeeder, network: Network, p_kw: Floats, q_kvar: Floats
) -> float | None:
    """Largest difference of a voltage for injections at the feeder's buses."""
    if feeder.source_flow is None:
        return None
    source = feeder.source_flow.v_pu(
        network.buses,
        p_kw - network.p_fixed_kw,
        q_kvar - network.q_fixed_kvar,
        network.v_slack_pu,
    )
    if source is None:
        return None
    try:
        result = ACPowerFlow(network).solve(p_kw, q_kvar)
    except VerificationError:
        return None
    return _apart(feeder, result.v_pu, source)


def _apart(feeder: ImportedFeeder, v_pu: Floats, source: Mapping[int, float]) -> float:
    """Largest difference of a voltage at the buses of the source."""
    at = feeder.network.bus_index
    pairs = ((v_pu[at[bus]], source[own]) for own, bus in feeder.bus_of.items() if own in source)
    return float(max(abs(ours - theirs) for ours, theirs in pairs))


def causes_of(net: Any, case: NetCase) -> Iterator[str]:
    """Causes of differences in voltage with their sizes, the largest first."""
    found = [*_held_voltages(net, case), *_following_loads(net, case)]
    yield from (words for _, words in sorted(found, key=lambda cause: -cause[0]))


def _held_voltages(net: Any, case: NetCase) -> Iterator[tuple[float, str]]:
    """Generators that hold a voltage with reactive power."""
    gens = supplied(net, "gen", case)
    if len(gens):
        kvar = float(mw_to_kw(net.res_gen["q_mvar"].reindex(gens.index).abs().sum()))
        names = named(label(net, "gen", i) for i in gens.index)
        yield (
            kvar,
            f"generators that hold their voltage in the source, with {kvar:.4g} kvar: {names}",
        )


def _following_loads(net: Any, case: NetCase) -> Iterator[tuple[float, str]]:
    """Loads whose power follows the voltage."""
    for kind, words in (("z", "impedance"), ("i", "current")):
        loads = supplied(net, "load", case)
        scaling = loads["scaling"].astype(float).fillna(1.0)
        p_kw = _share(loads, kind, "p") * mw_to_kw(loads["p_mw"].abs() * scaling)
        q_kvar = _share(loads, kind, "q") * mw_to_kw(loads["q_mvar"].abs() * scaling)
        if p_kw.any() or q_kvar.any():
            names = named(label(net, "load", i) for i in loads.index[(p_kw > 0) | (q_kvar > 0)])
            size = f"{p_kw.sum():.4g} kW and {q_kvar.sum():.4g} kvar"
            yield (
                float(np.hypot(p_kw.sum(), q_kvar.sum())),
                f"loads of constant {words} in the source, {size}: {names}",
            )


def _share(loads: pd.DataFrame, kind: str, power: str) -> Floats:
    """Share of each load's power that has constant impedance (z) or current (i)."""
    old, new = f"const_{kind}_percent", f"const_{kind}_{power}_percent"
    column = new if new in loads else old
    values = loads[column] if column in loads else pd.Series(0.0, loads.index)
    return np.asarray(values.astype(float).fillna(0.0)) / 100.0
