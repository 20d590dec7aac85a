"""What the paper publishes about the day: every aggregate that the scenario must meet.

The comments name the paper's tables: "scenario" is `tab:scenario-inputs`, "assets" is
`tab:assets-summary`, "thermal" is `tab:batt_therm_params`; "parameters" is its section "Parameter
Selection" and "text" any other sentence. Hours are UTC, hour beginning.
"""

from __future__ import annotations

# Scenario
START = "2022-07-19T00:00:00Z"
STEPS = 24
OUTAGE_START_HOUR = 12
PRICE_MEAN_GBP_PER_KWH = 0.36
PRICE_MIN_GBP_PER_KWH = 0.20
PRICE_MIN_HOUR = 23
PRICE_MAX_GBP_PER_KWH = 0.54
PRICE_MAX_HOUR = 18
PRICE_LOCAL_MIN_HOUR = 2  # text
PRICE_LOCAL_MAX_HOUR = 6  # text
ALERT_HOUR = 7  # text: charging starts here with H = 5, and in the full horizon's plan
HOTTEST_C = 40.3  # text: the record of the day, at Coningsby

# Assets: load
TIER_COUNTS = {"critical": 12, "high": 10, "low": 10}
POWER_FACTOR_MIN = 0.90
POWER_FACTOR_MEAN = 0.954
POWER_FACTOR_MAX = 0.98
LOAD_ENERGY_KWH = 86440.0
LOAD_PEAK_KW = 4068.0
LOAD_PEAK_HOUR = 17
NET_PEAK_KW = 3786.0
NET_PEAK_HOUR = 18

# Assets: PV. The total is printed as 1.857 MW and the mean of 28 as 66.34 kW, which together leave
# 1857.38 to 1857.5 kW: half the feeder's nominal load is 1857.5 kW.
PV_COUNT = 28
PV_TOTAL_KW = 1857.4
PV_MIN_KW = 24.77
PV_MAX_KW = 92.87
PV_INVERTERS_KVA = (30.0, 40.0, 100.0)
PV_ENERGY_KWH = 15080.0
PV_PEAK_HOUR = 11

# Assets: batteries. Totals of 2.542 MWh and 1.272 MW and means of 79.44 kWh and 39.74 kW over 32
# units leave 2541.92 to 2542.24 kWh and 1271.52 to 1271.84 kW.
BATTERY_ENERGY_KWH = 2542.08
BATTERY_ENERGY_MIN_KWH = 38.59
BATTERY_ENERGY_MAX_KWH = 165.5
BATTERY_POWER_KW = 1271.68
BATTERY_INVERTERS_KVA = (25.0, 45.0, 70.0, 90.0)
SOC_INITIAL = 0.15

# Parameters
V_MIN_PU = 0.947
V_MAX_PU = 1.053
V_MIN_AC_PU = 0.94
TIER_WEIGHTS = {"critical": 1.0, "high": 0.1, "low": 0.02}
SOC_MIN = 0.15
SOC_MAX = 0.85
EFFICIENCY = 0.95
LAMBDA_GRID = 1e-6
LAMBDA_CURT = 0.1
LAMBDA_L = 1e-14
LAMBDA_Q = 1e-15
HORIZON_H = 5.0

# Thermal
ALPHA_PER_C2 = 1e-4
R_INT_OHM = 0.0035
BETA_PER_C = 0.003
U_BATT_V = 900.0
R_THETA_C_PER_KW = (2.771, 4.486)
C_THETA_KWH_PER_C = (0.104, 0.439)
T_REF_C = 25.0
T_AMBIENT_START_C = 22.0
