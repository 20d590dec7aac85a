"""MATPOWER cases: arithmetic that computes units is evaluated, anything else refused by line."""

from __future__ import annotations

import random
from pathlib import Path
from typing import Any

import numpy as np
import pandapower as pp
import pandapower.networks as pp_networks
import pytest

from tests.support.own_power_flow import voltages
from vppres.core.errors import InputError
from vppres.feeders import import_network
from vppres.feeders.matpower.arithmetic import tables_of
from vppres.feeders.matpower.case import net_of, read_m
from vppres.feeders.matpower.text import Refused, parse
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
    "a base for each branch": "define_constants\n"
    + """baseMVA = mpc.baseMVA;
kv = mpc.bus(mpc.branch(:, F_BUS), BASE_KV);
Zbase = kv .^ 2 ./ baseMVA;
for c = [BR_R, BR_X]
    mpc.branch(:, c) = mpc.branch(:, c) ./ Zbase;
end
mpc.bus(:, 3:4) = 1e-3 * mpc.bus(:, 3:4);
""",
    "loops over rows": "[~, ~, BR_R, BR_X] = idx_brch();\n"
    + """for k = 1:size(mpc.branch, 1), f = mpc.branch(k, 1);
  z = mpc.bus(f, 10)^2 / mpc.baseMVA;
  mpc.branch(k, BR_R) = mpc.branch(k, BR_R)/z;
  mpc.branch(k, BR_X) = mpc.branch(k, BR_X)/z;
endfor
for (i = 1:length(mpc.bus(:, 1)))
  mpc.bus(i, [3 4]) = mpc.bus(i, [3 4]) * 10^-3;
end
return
system('never')
""",
    "masks and matrices": """on = mpc.branch(:, 11) == 1 & ~(mpc.branch(:, 3) < 0);
mpc.branch(on, 3:4) = mpc.branch(on, 3:4) / 12.1;
k = find(mpc.bus(:, 3) > 0);
D = [1/1000 0
     0 1/1000];
mpc.bus(k, 3:4) = mpc.bus(k, 3:4) * D';
mpc.bus(end, 12) = 1.1;
""",
}


def case_file(folder: Path, more: str) -> Path:
    file = folder / "pair.m"
    file.write_text(IN_KW_AND_OHM + more)
    return file


@pytest.mark.parametrize("way", WAYS)
def test_units_are_computed(way: str) -> None:
    tables = tables_of(parse(IN_KW_AND_OHM + WAYS[way]))
    assert tables["bus"][1, 2:4] == pytest.approx([PU_AND_MW["p"], PU_AND_MW["q"]], rel=1e-14)
    assert tables["branch"][0, 2:4] == pytest.approx([PU_AND_MW["r"], PU_AND_MW["x"]], rel=1e-14)
    assert tables["bus"][0].tolist() == [1, 3, 0, 0, 0, 0, 1, 1, 0, 11, 1, 1.1, 0.9]


def value(text: str) -> Any:
    """An expression's value, as rows of numbers."""
    return tables_of(parse(f"A = [1 2; 3 4];\nv = [5 6 7];\nmpc.x = {text};"))["x"].tolist()


# MATLAB's own rules, by hand.
EXPRESSIONS = [
    ("-2^2", [[-4]]),
    ("2^-1", [[0.5]]),
    ("2^3^2", [[64]]),
    ("1:3 + 1", [[1, 2, 3, 4]]),
    ("10:-5:0", [[10, 5, 0]]),
    ("[1 -2]", [[1, -2]]),
    ("[1 - 2]", [[-1]]),
    ("[A(1, :)' A(:, 2)]", [[1, 2], [2, 4]]),
    ("[A; v(1:2)]", [[1, 2], [3, 4], [5, 6]]),
    ("A(:)'", [[1, 3, 2, 4]]),
    ("A([1 4])", [[1, 4]]),
    ("A(A > 2)'", [[3, 4]]),
    ("A(end, end - 1)", [[3]]),
    ("v(end)", [[7]]),
    ("v([true; false; true])", [[5, 7]]),
    ("v([true 2])", [[5, 6]]),
    ("A * A", [[7, 10], [15, 22]]),
    ("A .* A", [[1, 4], [9, 16]]),
    ("A + [10; 20]", [[11, 12], [23, 24]]),
    ("sum(A)", [[4, 6]]),
    ("sum(A, 2)", [[3], [7]]),
    ("sum(v)", [[18]]),
    ("max(max(A), 3)", [[3, 4]]),
    ("round([-0.5 0.5 1.5])", [[-1, 1, 2]]),
    ("size(A)", [[2, 2]]),
    ("numel(v) + length(A)", [[5]]),
    ("1.*v", [[5, 6, 7]]),
    ("3 - -1", [[4]]),
    ("~(v == 6) + 0", [[1, 0, 1]]),
    ("1 + 1 == 2 & 0 < 1", [[1]]),
    ("zeros(1, 2)", [[0, 0]]),
    ("[zeros(0, 2); 1 2]", [[1, 2]]),
    ("1e3 + 1.5E-1 + 2d1", [[1020.15]]),
]


@pytest.mark.parametrize(("text", "expected"), EXPRESSIONS)
def test_expressions_by_hand(text: str, expected: Any) -> None:
    assert value(text) == expected


def test_rows_can_be_removed() -> None:
    text = (
        "mpc.branch = [1 2; 3 4; 5 6];\nmpc.branch(mpc.branch(:, 1) == 3, :) = [];\nb = mpc.branch;"
    )
    assert tables_of(parse(text + "\nb(1, 1) = 9;"))["branch"].tolist() == [[1, 2], [5, 6]]


def random_expression(draw: random.Random, depth: int) -> str:
    """A sum, product or function of numbers, which Python writes alike."""
    if depth == 0:
        return f"{draw.uniform(0.5, 9.0):.3f}"
    left, right = (random_expression(draw, depth - 1) for _ in range(2))
    form = draw.choice(["({0} + {1})", "{0} - {1}", "{0} * {1}", "{0} / (1 + abs({1}))", "-({0})"])
    return form.format(left, right)


def test_arithmetic_is_that_of_python() -> None:
    draw = random.Random(7)
    for _ in range(200):
        text = random_expression(draw, draw.randint(1, 5))
        assert value(text)[0][0] == pytest.approx(eval(text), rel=1e-12)


REFUSED = [
    ("if x > 1\n  y = 1;\nend", 14, "has 'if', which is not evaluated"),
    ("while 1\nend", 14, "has 'while', which is not evaluated"),
    ("system('touch canary');", 14, "has 'system', which is not an assignment"),
    ("mpc.bus(1) = system('touch canary');", 14, "calls 'system', which is not evaluated"),
    ("x = eval('1');", 14, "calls 'eval', which is not evaluated"),
    ("mpc = loadcase('case33bw');", 14, "builds mpc from something else than its tables"),
    ("[a, b] = deal(1, 2);", 14, "takes several outputs of 'deal'"),
    ("mpc.bus(:, PD) = 0;", 14, "has 'PD' before define_constants"),
    ("x = undefined + 1;", 14, "has 'undefined', which is no number that is known here"),
    ("x = 1 +;", 14, "has ';' where a value is expected"),
    ("x = (1;", 14, "has ';' where ')' is expected"),
    ("x = [1 2;\n\n", 14, "has a bracket that is not closed"),
    ("x = 'abc", 14, "has a quote that is not closed"),
    ("x = @(y) y;", 14, "has '@' where a value is expected"),
    ("x = mpc.bus(3, 1);", 14, "has the index 3, beyond the last, 2"),
    ("x = mpc.bus(1.5, 1);", 14, "has an index that is no whole number from 1"),
    ("x = mpc.bus(0, 1);", 14, "has an index that is no whole number from 1"),
    ("x = mpc.bus + [1 2 3];", 14, "combines 2 by 13 and 1 by 3 numbers"),
    ("x = 1 / [1 2];", 14, "divides by a matrix: './' divides"),
    ("x = [1 2] ^ 2;", 14, "has the power of a matrix: '.^' takes"),
    ("x = mpc.bus * mpc.bus;", 14, "multiplies 2 by 13 by 2 by 13 numbers"),
    ("mpc.bus(:, 3) = [1 2 3];", 14, "puts 1 by 3 values into 2 by 1 places of 'mpc.bus'"),
    ("x(3) = 1;", 14, "changes 'x', which has no value yet"),
    ("x = sqrt(-1);", 14, "has a result that is no real number"),
    ("x = acos(2);", 14, "has a result that is no real number"),
    ("x = sin(1, 2);", 14, "gives 'sin' 2 arguments"),
    ("x = mpc.bus_name;", 14, "has 'mpc.bus_name', which is no number that is known here"),
    ("\n\n  x = 1 2;", 16, "has '2' after a value"),
    ("for k = 1:3\n  x = k;", 14, "has a loop without its end"),
    ("x = zeros(1e5, 1e5);", 14, "makes a matrix of more than"),
    ("x = 1:1e9;", 14, "makes a matrix of more than"),
    ("x = ones(1e3);\ny = x * x;", 15, "takes more work than"),
    ("for i = 1:1e4\nfor j = 1:1e4\nx = 1;\nend\nend", 16, "takes more work than"),
    ("x = " + "(" * 60 + "1" + ")" * 60 + ";", 14, "is nested more than 30 deep"),
    ("x = " + "-" * 60 + "1;", 14, "is nested more than 30 deep"),
    ("x = 1" + " + 1" * 5000 + ";", 14, "has too long an expression"),
]


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
    assert problem.cure.startswith("Load the case in MATPOWER, write it with savecase")


def test_every_refused_statement_is_named() -> None:
    with pytest.raises(ExceptionGroup) as caught:
        parse("function mpc = c\ntic;\nmpc.baseMVA = 1;\nif 1\nx = 2;\nend\ndisp('x')\n")
    lines = [one.line for one in caught.value.exceptions if isinstance(one, Refused)]
    assert lines == [2, 4, 7]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("mpc.baseMVA = 10;", "", "(mpc.baseMVA is missing)"),
        ("mpc.baseMVA = 10;", "mpc.baseMVA = 0;", "has no positive number as mpc.baseMVA"),
        ("\t2\t1\t30", "\t1\t1\t30", "row 2 of mpc.bus has the number of another bus"),
        ("\t1\t2\t1.21", "\t1\t7\t1.21", "row 1 of mpc.branch has an unknown T_BUS"),
        ("\t1\t2\t1.21", "\t1\t2\tNaN", "row 1 of mpc.branch has no number in a column of"),
        ("mpc.gen = [1", "mpc.gen = [5", "row 1 of mpc.gen is at a bus that is not in mpc.bus"),
        ("mpc.gen = [1 0 0 10 -10 1 100 1 10 0]", "mpc.gen = [1 0]", "mpc.gen has 2 columns"),
        ("function mpc", "function [baseMVA, bus]", "is a case of version 1"),
    ],
)
def test_tables_that_are_no_case(old: str, new: str, message: str, tmp_path: Path) -> None:
    file = tmp_path / "pair.m"
    file.write_text(IN_KW_AND_OHM.replace(old, new))
    with pytest.raises(InputError) as caught:
        read_m(file)
    assert message in str(caught.value)


# Six buses at two levels: a swing bus with a second generator, a bus with voltage control, ratios
# at the higher and at the lower side, a phase shift, charging, shunts, parallel lines, a loop, a
# branch and a generator out of service, and negative demand.
WHOLE = {
    "bus": [
        [10, 3, 0.1, 0.05, 0, 0, 1, 1, 0, 33, 1, 1.1, 0.9],
        [20, 1, 0.9, 0.3, 0.02, 0.4, 1, 1, 0, 11, 1, 1.1, 0.9],
        [30, 2, 0.5, 0.2, 0, 0, 1, 1, 0, 11, 1, 1.1, 0.9],
        [40, 1, -0.3, 0.1, 0, 0, 1, 1, 0, 11, 1, 1.1, 0.9],
        [50, 1, 0.6, 0.2, 0, 0, 1, 1, 0, 33, 1, 1.1, 0.9],
        [60, 4, 0.6, 0.2, 0, 0, 1, 1, 0, 33, 1, 1.1, 0.9],
    ],
    "gen": [
        [10, 0, 0, 10, -10, 1.03, 100, 1, 10, 0],
        [10, 0.1, 0.1, 10, -10, 1.02, 100, 1, 10, 0],
        [30, 0.4, 0, 10, -10, 1.01, 100, 1, 10, 0],
        [40, 0.2, 0.1, 10, -10, 1.05, 100, 1, 10, 0],
        [40, 9.9, 0.1, 10, -10, 1.05, 100, 0, 10, 0],
    ],
    "branch": [
        [10, 20, 0.01, 0.06, 0, 0, 0, 0, 1.025, 30, 1, -360, 360],
        [20, 30, 0.03, 0.04, 0.02, 5, 0, 0, 0, 0, 1, -360, 360],
        [20, 30, 0.06, 0.05, 0.01, 0, 0, 0, 0, 0, 1, -360, 360],
        [30, 40, 0.05, 0.05, 0, 0, 0, 0, 1, 0, 1, -360, 360],
        [20, 40, 0.05, 0.05, 0, 0, 0, 0, 0, 0, 1, -360, 360],
        [10, 40, 0.05, 0.05, 0, 0, 0, 0, 0, 0, 0, -360, 360],
        [40, 50, 0.02, 0.08, 0.02, 0, 0, 0, 0.97, 0, 1, -360, 360],
    ],
}


def test_every_element_has_its_power_flow() -> None:
    case = {name: np.array(table, float) for name, table in WHOLE.items()}
    net = net_of(case | {"baseMVA": np.array([[10.0]])}, "whole.m")
    pp.runpp(net, calculate_voltage_angles=True, tolerance_mva=1e-9, numba=False)
    # The last generator of bus 10 has the say on its voltage.
    own = voltages(10.0, case["bus"], case["gen"], case["branch"])
    assert own[0] == 1.02
    v_pu = net.res_bus["vm_pu"].reindex(case["bus"][:, 0].astype(int)).to_numpy()
    assert v_pu == pytest.approx(own, abs=1e-9, nan_ok=True)


def test_a_reference_is_chosen_as_in_matpower() -> None:
    case = {name: np.array(table, float) for name, table in WHOLE.items()}
    case["gen"][:2, 7] = 0  # none in service at the swing bus
    net = net_of(case | {"baseMVA": np.array([[10.0]])}, "whole.m")
    assert net.ext_grid["bus"].tolist() == [30]
    assert len(net.gen) == 0


def test_ratings_are_those_of_the_file(tmp_path: Path) -> None:
    # 5 MVA at 11 kV; a zero says that there is none.
    case = {name: np.array(table, float) for name, table in WHOLE.items()}
    case["branch"] = case["branch"][[0, 1, 3, 6]]
    case["gen"][2, 7] = 0
    net = net_of(case | {"baseMVA": np.array([[10.0]])}, "whole.m")
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
