"""MATPOWER cases: units that they convert are computed, anything else is refused by line."""

from __future__ import annotations

import math
import random
from pathlib import Path
from typing import Any

import numpy as np
import pandapower as pp
import pandapower.networks as pp_networks
import pytest
import scipy.io

from tests.support.own_power_flow import voltages
from tests.support.refusals import refusal
from vppres.core.errors import InputError
from vppres.feeders import import_network
from vppres.feeders.matpower.case import net_of, read_m
from vppres.feeders.matpower.text import CURE, Refused, tables_of, words_of
from vppres.feeders.new.scenario import new_scenario
from vppres.physics.powerflow import ACPowerFlow

# Some of pandapower's own examples warn while they are built.
pytestmark = pytest.mark.filterwarnings("ignore::FutureWarning", "ignore::DeprecationWarning")

AGREEMENT = 1e-6

CONSTANTS = """
[PQ, PV, REF, NONE, BUS_I, BUS_TYPE, PD, QD, GS, BS, BUS_AREA, VM, ...
    VA, BASE_KV, ZONE, VMAX, VMIN, LAM_P, LAM_Q, MU_VMAX, MU_VMIN] = idx_bus;
[F_BUS, T_BUS, BR_R, BR_X, BR_B, RATE_A, RATE_B, RATE_C, ...
    TAP, SHIFT, BR_STATUS, PF, QF, PT, QT, MU_SF, MU_ST, ...
    ANGMIN, ANGMAX, MU_ANGMIN, MU_ANGMAX] = idx_brch;
"""

# Bus 2 draws 30 kW and 40 kvar; the line has 1.21 and 2.42 ohm, which are 0.1 and 0.2 pu at
# 11 kV and 10 MVA.
IN_KW_AND_OHM = """function mpc = pair  % a case
mpc.version = '2';
mpc.baseMVA = 10;
mpc.bus = [ %% Pd and Qd in kW and kvar
	1	3	0	0	0	0	1	1	0	11	1	1.1	0.9;
	2	1	30	40	0	0	1	1	0	11	1	1.1	0.9;   % 50% of 100's
];
mpc.gen = [1 0 0 10 -10 1 100 1 10 0];
mpc.branch = [
	1	2	1.21	2.42	0	0	0	0	0	0	1	-360	360;
];
mpc.bus_name = {'one'; 'it''s [two}'};
mpc.gencost = [2 0 0 3 0 20 Inf];
"""
PU_AND_MW = {"r": 0.1, "x": 0.2, "p": 0.03, "q": 0.04}

WAYS = {
    "columns by name": CONSTANTS
    + """
Vbase = mpc.bus(1, BASE_KV) * 1e3;      %% in Volts
Sbase = mpc.baseMVA * 1e6;              %% in VA
mpc.branch(:, [BR_R BR_X]) = mpc.branch(:, [BR_R BR_X]) / (Vbase^2 / Sbase);
mpc.bus(:, [PD, QD]) = mpc.bus(:, [PD, QD]) / 1e3;
""",
    "power factor": "define_constants;\n"
    + """pf = 0.6;
S = mpc.bus(:, PD) / pf;   % 50 kVA
mpc.bus(:, QD) = S * sin(acos(pf)) * 1e-3; mpc.bus(:, PD) = pf .* S ./ 1000
mpc.branch(:, BR_R:BR_X) = mpc.branch(:, BR_R:BR_X) * mpc.baseMVA / 11^2;
""",
    "columns by number": "define_constants\n"
    + """baseMVA = mpc.baseMVA;
Zbase = mpc.bus(1, BASE_KV) .^ 2 ./ baseMVA;
mpc.branch (:, [3\t4]) = mpc.branch(:, [BR_R BR_X]) ./ Zbase;
mpc.bus(:, 3:4) = 1e-3 * mpc.bus(:, 3:4);
return
system('never')
""",
}


def case_file(folder: Path, more: str) -> Path:
    file = folder / "pair.m"
    file.write_text(IN_KW_AND_OHM + more)
    return file


@pytest.mark.parametrize("way", WAYS)
def test_units_are_computed(way: str) -> None:
    tables = tables_of(IN_KW_AND_OHM + WAYS[way])
    assert tables["bus"][1, 2:4] == pytest.approx([PU_AND_MW["p"], PU_AND_MW["q"]], rel=1e-14)
    assert tables["branch"][0, 2:4] == pytest.approx([PU_AND_MW["r"], PU_AND_MW["x"]], rel=1e-14)
    assert tables["bus"][0].tolist() == [1, 3, 0, 0, 0, 0, 1, 1, 0, 11, 1, 1.1, 0.9]


def value(text: str) -> Any:
    """An expression's value, as rows of numbers."""
    return tables_of(f"A = [1 2; 3 4];\nv = [5 6 7];\nmpc.x = {text};")["x"].tolist()


# MATLAB's own rules, by hand.
EXPRESSIONS = [
    ("-2^2", [[-4]]),
    ("2^-1", [[0.5]]),
    ("2 .^ 3", [[8]]),
    ("12 / 2 * 3", [[18]]),
    ("A(1, [2 1])", [[2, 1]]),
    ("v(1, 1:2)", [[5, 6]]),
    ("A(:, 2)", [[2], [4]]),
    ("A ./ 2 - 1", [[-0.5, 0], [0.5, 1]]),
    ("1.*v", [[5, 6, 7]]),
    ("1./A(2, 2)", [[0.25]]),
    ("12 / A(2, 1) .* A(:, 2) / 2", [[4], [8]]),
    ("3 - -1", [[4]]),
    ("2 * sin(acos(0.6)) + 0 * pi", [[1.6]]),
    ("1e3 + 1.5E-1", [[1000.15]]),
    ("[1 -2; 3, 4 % four\n]", [[1, -2], [3, 4]]),
    ("2 + ... that is\n 3", [[5]]),
]


@pytest.mark.parametrize(("text", "expected"), EXPRESSIONS)
def test_expressions_by_hand(text: str, expected: Any) -> None:
    assert value(text) == [pytest.approx(row, rel=1e-15) for row in expected]


def random_expression(draw: random.Random, depth: int) -> str:
    """A sum, product or function of numbers, which Python writes alike."""
    if depth == 0:
        return f"{draw.uniform(0.5, 9.0):.3f}"
    left, right = (random_expression(draw, depth - 1) for _ in range(2))
    form = draw.choice(["({0} + {1})", "{0} - {1}", "{0} * {1}", "{0} / (2 + cos({1}))", "-({0})"])
    return form.format(left, right)


def test_arithmetic_is_that_of_python() -> None:
    draw = random.Random(7)
    for _ in range(200):
        text = random_expression(draw, draw.randint(1, 3))
        assert value(text)[0][0] == pytest.approx(eval(text, {"cos": math.cos}), rel=1e-12)


REFUSED = [
    ("if x > 1\n  y = 1;\nend", 14, "has 'if', which is not evaluated"),
    ("while 1\nend", 14, "has 'while', which is not evaluated"),
    ("for k = 1:3\n  x = k;\nend", 14, "has 'for', which is not evaluated"),
    ("system('touch canary');", 14, "has 'system', which is not evaluated"),
    ("!touch canary", 14, "has '!', which is not evaluated"),
    ("mpc.bus(1, 1) = system('touch canary');", 14, "has a text where a number is expected"),
    ("x = eval('1');", 14, "has a text where a number is expected"),
    ("x = exit(1);", 14, "calls 'exit', which is not evaluated"),
    ("x = __import__(1);", 14, "calls '__import__', which is not evaluated"),
    ("x = (lambda: 1);", 14, "has an expression that is not evaluated"),
    ("mpc = loadcase('case33bw');", 14, "builds mpc from something else than its tables"),
    ("[a, b] = deal(1, 2);", 14, "has '[', which is not evaluated"),
    ("[a, b] = deal;", 14, "takes 2 outputs of 'deal'"),
    ("function y = f(x)", 14, "is a function that is no case"),
    ("mpc.bus(:, PD) = 0;", 14, "has 'PD' before define_constants"),
    ("x = undefined + 1;", 14, "has 'undefined', which is no number that is known here"),
    ("x = 1 +;", 14, "has an expression that is not evaluated"),
    ("x = 1 2;", 14, "has an expression that is not evaluated"),
    ("x = 1_0;\nx = true;", 15, "has 'true', which is no number that is known here"),
    ("x = (1;", 14, "has the character ';'"),
    ("x = [1 2;\n\n", 14, "has the character ';'"),
    ("x = [1 2; 3]", 14, "has rows of different lengths"),
    ("x = [mpc.bus; mpc.bus]", 14, "has the character ';'"),
    ("x = 'abc", 14, "has the character"),
    ("x = mpc.bus';", 14, "has the character"),
    ("x = @(y) y;", 14, "has the character '@'"),
    ("x = mpc.bus(:, 3) > 0;", 14, "has the character '>'"),
    ("mpc.bus(1, :) = [];", 14, "changes something else than a row or columns of a table"),
    ("mpc.bus(1) = 2;", 14, "changes something else than a row or columns of a table"),
    ("x = mpc.bus(end, 1);", 14, "has 'end', which is no number that is known here"),
    ("x = mpc.bus(3, 1);", 14, "has the index 3, which is no whole number from 1 to 2"),
    ("y = 1.5;\nx = mpc.bus(y, 1);", 15, "has the index y, which is no whole number from 1 to 2"),
    ("x = mpc.bus(0, 1);", 14, "has the index 0, which is no whole number from 1 to 2"),
    ("y = [];\nx = mpc.bus(1, y);", 15, "has the index y, which is no whole number from 1 to 13"),
    ("x = mpc.bus(1, 1:14);", 14, "has the index 14, which is no whole number from 1 to 13"),
    ("x = mpc.bus(1.5, 1);", 14, "calls 'mpc.bus', which is not evaluated"),
    ("x = mpc.bus + mpc.gen;", 14,
        "combines 2 by 13 and 1 by 10 numbers: columns are only changed by one number"),
    ("x = mpc.bus(:, 1) .* mpc.gen;", 14, "combines 2 by 1 and 1 by 10 numbers"),
    ("x = [] + mpc.bus;", 14, "has an expression that is not evaluated"),
    ("x = [];\ny = x + mpc.bus;", 15, "combines 0 by 0 and 2 by 13 numbers"),
    ("x = 1 / mpc.bus(:, 3);", 14, "combines 1 by 1 and 2 by 1 numbers"),
    ("x = mpc.bus ^ 2;", 14, "combines 2 by 13 and 1 by 1 numbers"),
    ("x = 2^3^2;", 14, "has a power of a power"),
    ("x = mpc.bus * mpc.bus;", 14, "combines 2 by 13 and 2 by 13 numbers"),
    ("mpc.bus(:, 3) = mpc.gen;", 14, "puts 1 by 10 values into 2 by 1 places"),
    ("x(3, 1) = 1;", 14, "has 'x', which is no number that is known here"),
    ("x = sqrt(-1);", 14, "has a result that is no real number"),
    ("x = acos(2);", 14, "has a result that is no real number"),
    ("x = sin(1 + 1, 2);", 14, "calls 'sin', which is not evaluated"),
    ("x = mpc.bus_name;", 14, "has 'mpc.bus_name', which is no number that is known here"),
    ("\n\n  x = 1 2;", 16, "has an expression that is not evaluated"),
    ("x = 1:1e9;", 14, "has an expression that is not evaluated"),
    ("x = 1" + "0" * 800, 14, "has too long an expression"),
    ("x = " + "(" * 90 + "1" + ")" * 90 + ";\ny = z;", 15, "has 'z'"),
    ("x = 1" + " + 1" * 5000 + ";", 14, "has too long an expression"),
    ("x = '0';\ny = x;", 15, "has 'x', which is no number that is known here"),
    ("x = 1;\n" * 2000, 1006, "has more than 1000 statements"),
]  # fmt: skip


@pytest.mark.parametrize(("more", "row", "message"), REFUSED)
def test_what_is_no_arithmetic_is_refused_by_line(
    more: str, row: int, message: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError) as caught:
        read_m(case_file(tmp_path, more))
    (problem, *_) = caught.value.problems
    assert not isinstance(problem, str)
    assert problem.row == row
    assert message in problem.message
    assert problem.cure == CURE


def test_every_refused_statement_is_named() -> None:
    with pytest.raises(ExceptionGroup) as caught:
        tables_of("function mpc = c\ntic;\nmpc.baseMVA = 1;\nif 1\nx = 2;\nend\ndisp('x')\n")
    lines = [one.line for one in caught.value.exceptions if isinstance(one, Refused)]
    assert lines == [2, 4, 7]


@pytest.mark.parametrize(("old", "new", "message"), [
    ("mpc.baseMVA = 10;", "", "(mpc.baseMVA is missing)"),
    ("mpc.baseMVA = 10;", "mpc.baseMVA = 0;", "has no positive number as mpc.baseMVA"),
    ("\t2\t1\t30", "\t1\t1\t30", "row 2 of mpc.bus has the number of another bus"),
    ("\t1\t2\t1.21", "\t1\t7\t1.21", "row 1 of mpc.branch has an unknown T_BUS"),
    ("\t1\t2\t1.21", "\t1\t2\tNaN", "row 1 of mpc.branch has no number in a column of"),
    ("mpc.gen = [1", "mpc.gen = [5", "row 1 of mpc.gen is at a bus that is not in mpc.bus"),
    ("mpc.gen = [1 0 0 10 -10 1 100 1 10 0]", "mpc.gen = [1 0]", "mpc.gen has 2 columns"),
    ("function mpc", "function [baseMVA, bus]", "is a case of version 1"),
    ("\t2\t1\t30", "\t1e300\t1\t30", "row 2 of mpc.bus has no whole number up to"),
    ("\t2\t1\t30", "\t2\t1e300\t30", "row 2 of mpc.bus has no BUS_TYPE from 1 to 4"),
])  # fmt: skip
def test_tables_that_are_no_case(old: str, new: str, message: str, tmp_path: Path) -> None:
    file = tmp_path / "pair.m"
    file.write_text(IN_KW_AND_OHM.replace(old, new))
    assert message in refusal(read_m, file)


# Six buses at two levels: a swing bus with a second generator, a bus with voltage control, ratios
# at the higher and at the lower side, a phase shift, charging, shunts, parallel lines, a loop, a
# branch and a generator out of service, and negative demand.
WHOLE = {
    "bus": [[10, 3, 0.1, 0.05, 0, 0, 1, 1, 0, 33, 1, 1.1, 0.9],
        [20, 1, 0.9, 0.3, 0.02, 0.4, 1, 1, 0, 11, 1, 1.1, 0.9],
        [30, 2, 0.5, 0.2, 0, 0, 1, 1, 0, 11, 1, 1.1, 0.9],
        [40, 1, -0.3, 0.1, 0, 0, 1, 1, 0, 11, 1, 1.1, 0.9],
        [50, 1, 0.6, 0.2, 0, 0, 1, 1, 0, 33, 1, 1.1, 0.9],
        [60, 4, 0.6, 0.2, 0, 0, 1, 1, 0, 33, 1, 1.1, 0.9]],
    "gen": [[10, 0, 0, 10, -10, 1.03, 100, 1, 10, 0], [10, 0.1, 0.1, 10, -10, 1.02, 100, 1, 10, 0],
        [30, 0.4, 0, 10, -10, 1.01, 100, 1, 10, 0], [40, 0.2, 0.1, 10, -10, 1.05, 100, 1, 10, 0],
        [40, 9.9, 0.1, 10, -10, 1.05, 100, 0, 10, 0]],
    "branch": [[10, 20, 0.01, 0.06, 0, 0, 0, 0, 1.025, 30, 1, -360, 360],
        [20, 30, 0.03, 0.04, 0.02, 5, 0, 0, 0, 0, 1, -360, 360],
        [20, 30, 0.06, 0.05, 0.01, 0, 0, 0, 0, 0, 1, -360, 360],
        [30, 40, 0.05, 0.05, 0, 0, 0, 0, 1, 0, 1, -360, 360],
        [20, 40, 0.05, 0.05, 0, 0, 0, 0, 0, 0, 1, -360, 360],
        [10, 40, 0.05, 0.05, 0, 0, 0, 0, 0, 0, 0, -360, 360],
        [40, 50, 0.02, 0.08, 0.02, 0, 0, 0, 0.97, 0, 1, -360, 360]],
}  # fmt: skip


def test_every_element_has_its_power_flow() -> None:
    case = {name: np.array(table, float) for name, table in WHOLE.items()}
    net, _ = net_of(case | {"baseMVA": np.array([[10.0]])}, "whole.m")
    pp.runpp(net, calculate_voltage_angles=True, tolerance_mva=1e-9, numba=False)
    # The last generator of bus 10 has the say on its voltage.
    own = voltages(10.0, case["bus"], case["gen"], case["branch"])
    assert own[0] == 1.02
    v_pu = net.res_bus["vm_pu"].reindex(case["bus"][:, 0].astype(int)).to_numpy()
    assert v_pu == pytest.approx(own, abs=1e-9, nan_ok=True)


def test_a_reference_is_chosen_as_in_matpower() -> None:
    case = {name: np.array(table, float) for name, table in WHOLE.items()}
    case["gen"][:2, 7] = 0  # none in service at the swing bus
    net, notes = net_of(case | {"baseMVA": np.array([[10.0]])}, "whole.m")
    assert net.ext_grid["bus"].tolist() == [30]
    assert len(net.gen) == 0
    assert notes == (
        "No generator in service is at a bus of type 3: bus 30, the first of type 2, is the grid "
        "connection.",
    )


STANDBY = """mpc.gen = [
	1 0 0 10 -10 1 100 1 10 0;
	2 0 0 10 -10 1 100 1 0.05 0.01;  % tested on Mondays
	2 0.02 0 10 -10 1 100 1 0.04 0;
	2 9 0 10 -10 1 100 0 9 0;
];
% mpc.genfuel = {'solar'; 'solar'; 'solar'; 'solar'};
mpc.genfuel = {
	'unknown';
	'dfo';  % the hospital's
	'solar';
	'wind';
};"""
FUELLED = IN_KW_AND_OHM.replace("mpc.gen = [1 0 0 10 -10 1 100 1 10 0];", STANDBY)


@pytest.mark.parametrize("binary", [False, True])
def test_a_standby_set_of_a_case_forms_the_grid_of_an_island(tmp_path: Path, binary: bool) -> None:
    text = FUELLED + WAYS["columns by name"]
    file = tmp_path / ("pair.mat" if binary else "pair.m")
    if binary:
        fuels = np.array(words_of(text, "genfuel"), dtype=object)
        case = {**tables_of(text), "version": "2", "genfuel": fuels}
        scipy.io.savemat(file, {"mpc": case})
    else:
        file.write_text(text)
    feeder = import_network(file)
    assert feeder.generators.kind.tolist() == ["diesel", "solar"]
    assert feeder.generators.p_max_kw.tolist() == [50.0, 40.0]
    sets = new_scenario(feeder).gensets
    assert (sets.bus.tolist(), sets.p_max_kw.tolist(), sets.p_min_kw.tolist()) == (
        [2], [50.0], [10.0],
    )  # fmt: skip
    assert sets.grid_forming.tolist() == [True]


def test_fuels_that_are_not_told_of_each_generator_say_nothing(tmp_path: Path) -> None:
    file = tmp_path / "pair.m"
    file.write_text(FUELLED.replace("\t'wind';\n", "") + WAYS["columns by name"])
    assert len(new_scenario(import_network(file)).gensets) == 0


def test_ratings_are_those_of_the_file(tmp_path: Path) -> None:
    # 5 MVA at 11 kV; a zero says that there is none.
    case = {name: np.array(table, float) for name, table in WHOLE.items()}
    case["branch"] = case["branch"][[0, 1, 3, 6]]
    case["gen"][2, 7] = 0
    net, _ = net_of(case | {"baseMVA": np.array([[10.0]])}, "whole.m")
    network = import_network(net, balance=True).network
    i_max_a = dict(zip(network.to_bus, network.i_max_a, strict=True))
    assert i_max_a.pop(30) == pytest.approx(5e3 / (np.sqrt(3) * 11))
    assert not np.isfinite([*i_max_a.values()]).any()


def kw_and_ohm_of(net: Any) -> tuple[str, dict[str, Any]]:
    """A published feeder as a case that computes its units, and its tables in MW and pu."""
    base_mva, kv = 10.0, float(net.bus["vn_kv"].iloc[0])
    bus = np.zeros((len(net.bus), 13))
    bus[:, 0] = net.bus.index + 1
    bus[:, 1] = np.where(net.bus.index == net.ext_grid["bus"].iloc[0], 3, 1)
    load = net.load.groupby("bus")[["p_mw", "q_mvar"]].sum().reindex(net.bus.index, fill_value=0.0)
    bus[:, 2:4] = load.to_numpy() * 1e3
    bus[:, [7, 9, 10, 11, 12]] = 1, kv, 1, 1.1, 0.9
    lines = net.line
    branch = np.zeros((len(lines), 13))
    branch[:, 0:2] = lines[["from_bus", "to_bus"]].to_numpy() + 1
    branch[:, 2] = lines["r_ohm_per_km"] * lines["length_km"]
    branch[:, 3] = lines["x_ohm_per_km"] * lines["length_km"]
    branch[:, 10] = lines["in_service"]
    gen = np.array([[net.ext_grid["bus"].iloc[0] + 1, 0, 0, 9, -9, 1, 9, 1, 9, 0]], float)
    rows = {
        name: ";\n".join("\t".join(f"{v:.17g}" for v in row) for row in table)
        for name, table in (("bus", bus), ("gen", gen), ("branch", branch))
    }
    text = "function mpc = published\nmpc.version = '2';\nmpc.baseMVA = 10;\n" + "".join(
        f"mpc.{name} = [\n{table};\n];\n" for name, table in rows.items()
    )
    bus[:, 2:4] /= 1e3
    branch[:, 2:4] /= kv**2 / base_mva
    return text, {"base_mva": base_mva, "bus": bus, "gen": gen, "branch": branch}


def test_imported_voltages_are_those_of_the_file(tmp_path: Path) -> None:
    text, tables = kw_and_ohm_of(pp_networks.case33bw())
    file = tmp_path / "published.m"
    file.write_text(text + WAYS["columns by name"])
    feeder = import_network(file)
    result = ACPowerFlow(feeder.network).solve(*feeder.injection)
    own = dict(zip(tables["bus"][:, 0].astype(int), voltages(**tables), strict=True))
    assert feeder.network.n_buses == 33
    expected = [own[bus] for bus in feeder.network.buses]
    assert result.v_pu == pytest.approx(expected, abs=AGREEMENT)
    assert min(expected) == pytest.approx(0.91309, abs=1e-5)  # published
