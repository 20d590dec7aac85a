"""What the paper publishes, and how near ours must come: the one place for both.

Figures are named by the paper's LaTeX labels. A range of values has two ends; a single value is a
range of length zero; a statement in words has none and is judged by an assertion in the experiment.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Statement:
    """One published statement."""

    id: str  #: R1 to R24; a letter tells the parts of a statement apart
    where: str  #: place in the paper
    quantity: str  #: what is stated
    published: str  #: the paper's value as printed, or its words in short
    #: Ends of the published range.
    low: float | None = None
    high: float | None = None
    tolerance: float = 0.0  #: how far outside the range ours may lie

    def difference(self, ours: float) -> float:
        """Signed distance of a value to the published range, zero inside."""
        low = ours if self.low is None else self.low
        high = ours if self.high is None else self.high
        return min(ours - low, 0.0) + max(ours - high, 0.0)

    def holds(self, ours: float) -> bool:
        """Whether a value lies within the tolerance."""
        # The last bits of a sum must not decide.
        return abs(self.difference(ours)) <= self.tolerance + 1e-12


V_MIN_MODEL_PU = 0.947
V_MIN_AC_PU = 0.94
SOLVER_TOLERANCE_PU = 1e-5
"""How far a solver may pass a bound on the voltage."""
V_MEAN_PU = {"MPC": 0.9607, "full horizon": 0.9601}
IMPORT_KWH = {"MPC": 60854.07, "full horizon": 60691.72}


def between(published: dict[str, float]) -> float:
    """Half of what two published values differ by: a wider tolerance would not tell them apart."""
    low, high = sorted(published.values())
    return (high - low) / 2


_ALL = (
    Statement(
        "R1", "fig:1a", "Resilience, ideal conditions, MPC at H = 5", "about 0.92", 0.92, 0.92, 0.01
    ),
    Statement(
        "R2",
        "fig:1a",
        "Resilience, ideal conditions: MPC less full horizon",
        "the same",
        0.0,
        0.0,
        0.002,
    ),
    Statement(
        "R2b", "text", "Corrections of the full horizon under ideal conditions", "none", 0, 0
    ),
    Statement(
        "R3a",
        "fig:1a, text",
        "Resilience for H of 4 and more: largest distance to the full horizon's",
        "plateau at the full-horizon value",
        0.0,
        0.0,
        0.003,
    ),
    Statement("R3b", "fig:1a, text", "Resilience against H below 4", "degrades for H < 4"),
    Statement("R3c", "fig:1a, text", "Cost against H up to the plateau", "rises with H"),
    Statement(
        "R4",
        "fig:1b",
        "Lowest voltage in the optimisation, any hour (pu)",
        "at or above 0.947",
        V_MIN_MODEL_PU,
        None,
        SOLVER_TOLERANCE_PU,
    ),
    Statement("R5", "fig:1b", "Lowest AC voltage, any hour (pu)", "above 0.94", V_MIN_AC_PU, None),
    Statement(
        "R6a",
        "text",
        "Mean over the day of the lowest AC voltage, MPC (pu)",
        "0.9607",
        V_MEAN_PU["MPC"],
        V_MEAN_PU["MPC"],
        between(V_MEAN_PU),
    ),
    Statement(
        "R6b",
        "text",
        "Mean over the day of the lowest AC voltage, full horizon (pu)",
        "0.9601",
        V_MEAN_PU["full horizon"],
        V_MEAN_PU["full horizon"],
        between(V_MEAN_PU),
    ),
    Statement(
        "R7",
        "text",
        "MPC: largest difference of optimisation and AC voltage (pu)",
        "below 0.005",
        None,
        0.005,
    ),
    Statement("R8", "fig:1c, text", "Charging in hours 0 to 2", "charges, most at hour 2"),
    Statement(
        "R9", "fig:1c, text", "Hours 3 to 6", "discharges; at hour 6 against the local price peak"
    ),
    Statement(
        "R10",
        "fig:1c, text",
        "Hours 7 to 11",
        "fast charging from hour 7, near the maximum by hour 11",
    ),
    Statement(
        "R10b",
        "fig:1c, text",
        "Hours 7 to 11: largest distance of the stored energies of MPC and full horizon, share of "
        "the usable energy",
        "near-identical",
        0.0,
        0.0,
        0.05,
    ),
    Statement(
        "R11",
        "fig:1c, text",
        "The outage",
        "modest discharge in 12 to 15, faster in 16 to 18, near the minimum at its end",
    ),
    Statement("R12a", "fig:1d, text", "Largest grid import", "at hour 2"),
    Statement(
        "R12b",
        "fig:1d, text",
        "Import at hour 6 over the smallest import with grid, less one",
        "hour 6 is the smallest",
        0.0,
        0.0,
        0.02,
    ),
    Statement(
        "R12c", "fig:1d, text", "Import in the outage, net of AC losses (kW)", "zero", 0.0, 0.0, 1.0
    ),
    Statement(
        "R12d",
        "fig:1d, text",
        "Mean distance of the imports of MPC and full horizon, share of the mean import",
        "nearly overlapping",
        0.0,
        0.0,
        0.02,
    ),
    Statement(
        "R13",
        "fig:2, text",
        "MPC resilience under forecast errors",
        "0.90 to 0.92",
        0.90,
        0.92,
        0.01,
    ),
    Statement(
        "R14",
        "fig:2, text",
        "Full-horizon resilience under forecast errors, median over builder seeds",
        "0.75 to 0.81",
        0.75,
        0.81,
        0.02,
    ),
    Statement(
        "R14b",
        "fig:2, text",
        "Full horizon in fact, under growing random error",
        "degrades as errors grow",
    ),
    Statement(
        "R15",
        "fig:2, text",
        "Full horizon as planned, under growing random error",
        "degrades moderately",
    ),
    Statement(
        "R16a",
        "fig:2b, text",
        "Negative load bias, full horizon",
        "charges less, costs less, lower resilience",
    ),
    Statement(
        "R16b", "fig:2b, text", "Positive load bias, full horizon", "costs more, lower resilience"
    ),
    Statement(
        "R17a",
        "fig:2d, text",
        "Positive PV bias, full horizon",
        "as negative load bias: charges less, lower resilience",
    ),
    Statement(
        "R17b",
        "fig:2d, text",
        "Negative PV bias, full horizon",
        "as positive load bias: costs more, lower resilience",
    ),
    Statement(
        "R18",
        "abstract",
        "Improvement of MPC, packaged day, over full horizon, median over builder seeds",
        "11 to 20 %",
        0.11,
        0.20,
        0.02,
    ),
    Statement(
        "R19a", "tab:eff", "Resilience with battery heating, MPC at H = 6", "0.90", 0.90, 0.90, 0.02
    ),
    Statement(
        "R19b", "tab:eff", "Resilience with battery heating, full horizon", "0.81", 0.81, 0.81, 0.02
    ),
    Statement(
        "R19c",
        "tab:eff, text",
        "Improvement of MPC over full horizon with battery heating",
        "11 %",
        0.11,
        0.11,
        0.02,
    ),
    Statement(
        "R20a",
        "tab:eff",
        "Imported energy with battery heating, MPC (kWh)",
        "60854.07",
        IMPORT_KWH["MPC"],
        IMPORT_KWH["MPC"],
        between(IMPORT_KWH),
    ),
    Statement(
        "R20b",
        "tab:eff",
        "Imported energy with battery heating, full horizon (kWh)",
        "60691.72",
        IMPORT_KWH["full horizon"],
        IMPORT_KWH["full horizon"],
        between(IMPORT_KWH),
    ),
    Statement(
        "R21",
        "fig:3, text",
        "Full horizon: stored energy at hour 11 below the plan (kWh)",
        "about 150",
        150.0,
        150.0,
        75.0,
    ),
    Statement(
        "R22",
        "text",
        "Share of customers served with grid, every tier",
        "every customer, at all steps",
        1.0,
        1.0,
    ),
    Statement(
        "R23", "text", "Curtailed PV energy, share of the day's", "negligible", 0.0, 0.0, 0.001
    ),
    Statement(
        "R24",
        "tab:eff, text",
        "Imported energy with battery heating: MPC less full horizon (kWh)",
        "162 more",
        162.35,
        162.35,
        81.0,
    ),
)

STATEMENTS = {statement.id: statement for statement in _ALL}
"""Every statement by its id."""
