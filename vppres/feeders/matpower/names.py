"""Names of the columns of MATPOWER's tables, as its functions of constants give them out."""

from __future__ import annotations


def _numbered(first: int, names: str) -> dict[str, int]:
    return {name: number for number, name in enumerate(names.split(), start=first)}


FUNCTIONS = {
    "idx_bus": _numbered(1, "PQ PV REF NONE")
    | _numbered(1, "BUS_I BUS_TYPE PD QD GS BS BUS_AREA VM VA BASE_KV ZONE VMAX VMIN")
    | _numbered(14, "LAM_P LAM_Q MU_VMAX MU_VMIN"),
    "idx_brch": _numbered(1, "F_BUS T_BUS BR_R BR_X BR_B RATE_A RATE_B RATE_C TAP SHIFT BR_STATUS")
    | _numbered(14, "PF QF PT QT MU_SF MU_ST")
    | _numbered(12, "ANGMIN ANGMAX")
    | _numbered(20, "MU_ANGMIN MU_ANGMAX"),
    "idx_gen": _numbered(1, "GEN_BUS PG QG QMAX QMIN VG MBASE GEN_STATUS PMAX PMIN")
    | _numbered(22, "MU_PMAX MU_PMIN MU_QMAX MU_QMIN")
    | _numbered(11, "PC1 PC2 QC1MIN QC1MAX QC2MIN QC2MAX RAMP_AGC RAMP_10 RAMP_30 RAMP_Q APF"),
    "idx_cost": _numbered(1, "PW_LINEAR POLYNOMIAL")
    | _numbered(1, "MODEL STARTUP SHUTDOWN NCOST COST"),
}
"""Outputs of each function in their order, with their values."""

ALL = {name: value for outputs in FUNCTIONS.values() for name, value in outputs.items()}
"""What ``define_constants`` defines."""
