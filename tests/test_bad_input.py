"""Every mistake in a scenario folder gets its own message: file, row, field, value, cure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from experiments.mutations import (
    FILES,
    MOST_CUT,
    ROW_EDITS,
    SNIPPETS,
    study,
    with_row,
    with_snippet,
)
from tests.support.processor import processor_s_below
from tests.support.tiny_day import tiny_scenario
from vppres.core.errors import InputError
from vppres.day.options import RunOptions
from vppres.feeders import import_network
from vppres.io import find_scenario, read_scenario, scenario_digest, write_scenario
from vppres.io.messages import MAX_PROBLEMS_PER_FILE, MAX_PROBLEMS_PER_KIND
from vppres.io.python_door import check_scenario

GRID_CURE = "The scenario's steps begin at 2022-07-19T10:00:00Z and last 60 min; there are 6."
DAY = "The day is 2022-07-19T10:00:00Z to 2022-07-19T16:00:00Z, in steps of 60 min."
FILE_CURE = "Add it, or name another file under [files] in scenario.toml."
NAME_CURE = "Give a file name in the scenario folder that ends in .csv or .parquet."

# name: (file, text in the valid folder, text that replaces it, the messages)
EDITS: dict[str, tuple[str, str, str, list[str]]] = {
    # scenario.toml: syntax and shape
    "toml syntax": (
        "scenario.toml",
        "steps = 6",
        "steps = = 6",
        ["scenario.toml, row 10: is not valid TOML: Invalid value. Correct this line."],
    ),
    "toml key twice": (
        "scenario.toml",
        "steps = 6",
        "steps = 6\nsteps = 7",
        ["scenario.toml, row 11: is not valid TOML: Cannot overwrite a value. Correct this line."],
    ),
    "toml cut off": (
        "scenario.toml",
        'kind = "mpc"',
        "kind =",
        ["scenario.toml, row 40: is not valid TOML: Invalid value. Correct this line."],
    ),
    "unknown section": (
        "scenario.toml",
        "[controller]",
        "[controler]",
        ["scenario.toml, controler: is not a known key. Did you mean controller?"],
    ),
    "unknown key": (
        "scenario.toml",
        "v_min_pu = 0.947",
        "v_minimum = 0.947",
        ["scenario.toml, network.v_minimum: is not a known key. Did you mean v_min_pu?"],
    ),
    "unknown key, nothing near": (
        "scenario.toml",
        'kind = "mpc"',
        'gurobi = "yes"',
        [
            "scenario.toml, controller.gurobi: is not a known key. Remove it. "
            "Known: kind, horizon_h, mode, soc_end, outages, voltage_limits, ratings."
        ],
    ),
    "missing key": (
        "scenario.toml",
        "steps = 6\n",
        "",
        ["scenario.toml, time.steps: is missing. Give the number of steps."],
    ),
    "missing section": (
        "scenario.toml",
        "[tiers]\ncritical = 1.0\nhigh = 0.1\nlow = 0.02\n",
        "",
        [
            "scenario.toml, tiers: is missing. Give the table [tiers]: weight of each tier, most "
            "important first."
        ],
    ),
    "empty tiers": (
        "scenario.toml",
        "critical = 1.0\nhigh = 0.1\nlow = 0.02\n",
        "",
        [
            "scenario.toml, tiers: is empty. Give the table [tiers]: weight of each tier, most "
            "important first."
        ],
    ),
    "section is a number": (
        "scenario.toml",
        '[controller]\nkind = "mpc"\nhorizon_h = 5.0\nmode = "paper"\n'
        'voltage_limits = "hard"\nratings = "report"',
        "[files]\npv_kw = 3",
        ["scenario.toml, files.pv_kw = 3: is not text. Give the file of the PV series."],
    ),
    "outages as one table": (
        "scenario.toml",
        "outages = [\n    { start = 2022-07-19 13:00:00+00:00, "
        "end = 2022-07-19 15:00:00+00:00 },\n]",
        "outages = 6",
        [
            "scenario.toml, outages = 6: is not a list of tables. Write [[outages]] with start and "
            "end for each outage."
        ],
    ),
    # scenario.toml: values
    "name with a slash": (
        "scenario.toml",
        'name = "tiny"',
        'name = "a/b"',
        [
            "scenario.toml, name = a/b: is not allowed. Give the short name of the scenario: "
            "letters, digits, '-', '_' and '.'."
        ],
    ),
    "start without zone": (
        "scenario.toml",
        "start = 2022-07-19 10:00:00+00:00",
        "start = 2022-07-19T10:00:00",
        [
            "scenario.toml, time.start = 2022-07-19 10:00:00: has no time zone. Write it with an "
            "offset, for example 2022-07-19T12:00:00Z."
        ],
    ),
    "start in quotes": (
        "scenario.toml",
        "start = 2022-07-19 10:00:00+00:00",
        'start = "2022-07-19T10:00:00Z"',
        [
            "scenario.toml, time.start = 2022-07-19T10:00:00Z: is not a date and time. Write it with "
            "offset and without quotes, for example 2022-07-19T12:00:00Z."
        ],
    ),
    "start in another century": (
        "scenario.toml",
        "start = 2022-07-19 10:00:00+00:00",
        "start = 0022-07-19T10:00:00Z",
        [
            "scenario.toml, time.start = 0022-07-19T10:00:00Z: must lie in the years 1970 to 2199. "
            "Correct the year."
        ],
    ),
    "step of zero": (
        "scenario.toml",
        "step_minutes = 60.0",
        "step_minutes = 0",
        [
            "scenario.toml, time.step_minutes = 0: must be at least 1. "
            "Give the length of a step in min."
        ],
    ),
    "step as text": (
        "scenario.toml",
        "step_minutes = 60.0",
        'step_minutes = "60"',
        [
            "scenario.toml, time.step_minutes = 60: is not a number. "
            "Give the length of a step in min."
        ],
    ),
    "half a step": (
        "scenario.toml",
        "steps = 6",
        "steps = 6.5",
        ["scenario.toml, time.steps = 6.5: is not a whole number. Give the number of steps."],
    ),
    "no step": (
        "scenario.toml",
        "steps = 6",
        "steps = 0",
        ["scenario.toml, time.steps = 0: must be at least 1. Give the number of steps."],
    ),
    "many years": (
        "scenario.toml",
        "steps = 6",
        "steps = 500000",
        [
            "scenario.toml, time.steps = 500000: the scenario is longer than 366 days. "
            "Reduce steps or step_minutes."
        ],
    ),
    "not a number": (
        "scenario.toml",
        "base_kv = 11.0",
        "base_kv = nan",
        [
            "scenario.toml, network.base_kv = nan: is not a finite number. "
            "Give the nominal line-to-line voltage in kV."
        ],
    ),
    "infinite": (
        "scenario.toml",
        "base_kv = 11.0",
        "base_kv = inf",
        [
            "scenario.toml, network.base_kv = inf: is not a finite number. "
            "Give the nominal line-to-line voltage in kV."
        ],
    ),
    "voltage limits crossed": (
        "scenario.toml",
        "v_min_pu = 0.947",
        "v_min_pu = 1.06",
        [
            "scenario.toml, network.v_min_pu = 1.06: must be less than v_max_pu (1.053). "
            "Correct one of the limits."
        ],
    ),
    "slack voltage out of limits": (
        "scenario.toml",
        "v_slack_pu = 1.0",
        "v_slack_pu = 1.055",
        [
            "scenario.toml, network.v_slack_pu = 1.055: must lie between v_min_pu (0.947) and "
            "v_max_pu (1.053). Correct the voltage of the slack bus or the limits."
        ],
    ),
    "unknown slack bus": (
        "scenario.toml",
        "slack_bus = 1",
        "slack_bus = 9",
        [
            "scenario.toml, network.slack_bus = 9: no line touches the slack bus 9. "
            "Correct slack_bus or the lines."
        ],
    ),
    "tier weight of zero": (
        "scenario.toml",
        "low = 0.02",
        "low = 0",
        [
            "scenario.toml, tiers.low = 0: must be at least 1e-06. Give the table [tiers]: weight of "
            "each tier, most important first."
        ],
    ),
    "negative lambda": (
        "scenario.toml",
        "lambda_curt = 0.1",
        "lambda_curt = -0.1",
        [
            "scenario.toml, objective.lambda_curt = -0.1: must be at least 0. "
            "Give the weight of curtailed PV power in 1/kW."
        ],
    ),
    "unknown controller": (
        "scenario.toml",
        'kind = "mpc"',
        'kind = "pid"',
        [
            "scenario.toml, controller.kind = pid: must be 'mpc', 'full-horizon', 'perfect', 'idle' "
            "or 'reserve'. Give the controller."
        ],
    ),
    "negative horizon": (
        "scenario.toml",
        "horizon_h = 5.0",
        "horizon_h = -1",
        [
            "scenario.toml, controller.horizon_h = -1: must be at least 0. "
            "Give the prediction horizon of the MPC; 0 is one step in h."
        ],
    ),
    "negative minimum time": (
        "scenario.toml",
        "[controller]",
        "[switching]\nmin_served_h = -1\n[controller]",
        [
            "scenario.toml, switching.min_served_h = -1: must be at least 0. "
            "Give the shortest time on supply after a restoration in h."
        ],
    ),
    "cold load below the usual": (
        "scenario.toml",
        "[controller]",
        "[switching]\ncold_load_factor = 0.5\n[controller]",
        [
            "scenario.toml, switching.cold_load_factor = 0.5: must be at least 1. "
            "Give the demand after a restoration as a multiple of the usual one."
        ],
    ),
    "half an action": (
        "scenario.toml",
        "[controller]",
        "[switching]\nmax_actions_per_customer = 1.5\n[controller]",
        [
            "scenario.toml, switching.max_actions_per_customer = 1.5: is not a whole number. "
            "Give the most actions of a customer in a day (no such key: no limit)."
        ],
    ),
    "yes in the place of true": (
        "scenario.toml",
        "[controller]",
        '[switching]\nstay_restored = "yes"\n[controller]',
        [
            "scenario.toml, switching.stay_restored = yes: is not true or false. "
            "Write true or false, without quotes."
        ],
    ),
    "file elsewhere": (
        "scenario.toml",
        "[controller]",
        '[files]\nsystem = "../system.csv"\n[controller]',
        [f"scenario.toml, files.system = ../system.csv: is not allowed. {NAME_CURE}"],
    ),
    "file of another kind": (
        "scenario.toml",
        "[controller]",
        '[files]\nsystem = "system.xlsx"\n[controller]',
        [f"scenario.toml, files.system = system.xlsx: is not allowed. {NAME_CURE}"],
    ),
    "listed file is missing": (
        "scenario.toml",
        "[controller]",
        '[files]\nsystem = "feeder.csv"\n[controller]',
        [f"feeder.csv: the file is missing. {FILE_CURE}"],
    ),
    # outages
    "outage ends before it begins": (
        "scenario.toml",
        "end = 2022-07-19 15:00:00+00:00",
        "end = 2022-07-19 13:00:00+00:00",
        [
            "scenario.toml, outages[1].end = 2022-07-19T13:00:00Z: must be after the outage's start "
            "(2022-07-19T13:00:00Z). Correct start or end."
        ],
    ),
    "outage on another day": (
        "scenario.toml",
        "end = 2022-07-19 15:00:00+00:00",
        "end = 2022-07-20 15:00:00+00:00",
        [
            "scenario.toml, outages[1].end = 2022-07-20T15:00:00Z: lies outside the scenario's day. "
            + DAY
        ],
    ),
    "outage inside a step": (
        "scenario.toml",
        "{ start = 2022-07-19 13:00",
        "{ start = 2022-07-19 13:30",
        ["scenario.toml, outages[1].start = 2022-07-19T13:30:00Z: lies inside a step. " + DAY],
    ),
    "outage without end": (
        "scenario.toml",
        ", end = 2022-07-19 15:00:00+00:00",
        "",
        ["scenario.toml, outages[1].end: is missing. Give the end of the outage, with time zone."],
    ),
    # any CSV file
    "ragged row": (
        "customers.csv",
        "shop,3,high,0.9",
        "shop,3,high",
        [
            "customers.csv, row 3: has 3 cells, but the header has 4. "
            "Give one cell per column; quote a cell that contains a comma."
        ],
    ),
    "decimal comma": (
        "lines.csv",
        "1,2,0.3,0.2",
        "1,2,0,3,0.2",
        [
            "lines.csv, row 2: has 5 cells, but the header has 4. "
            "Give one cell per column; quote a cell that contains a comma."
        ],
    ),
    "semicolons": (
        "pv.csv",
        "id,customer,p_max_kw,s_max_kva\nroof,hospital,30.0,40.0\nfield,homes,20.0,30.0",
        "id;customer;p_max_kw;s_max_kva\nroof;hospital;30,0;40,0",
        [
            "pv.csv, row 1: has a single column. Separate the cells with commas, and write decimal "
            "points.",
        ],
    ),
    "open quote": (
        "pv.csv",
        "field,homes",
        '"field,homes',
        [
            "pv.csv, row 3: is not valid CSV (unexpected end of data). "
            "Correct the quotes of this row."
        ],
    ),
    "column twice": (
        "pv.csv",
        "id,customer,p_max_kw,s_max_kva",
        "id,customer,p_max_kw,p_max_kw",
        ["pv.csv, row 1, p_max_kw: the column appears twice. Remove or rename one of them."],
    ),
    "column without name": (
        "pv.csv",
        "id,customer,p_max_kw,s_max_kva",
        "id,customer,,s_max_kva",
        ["pv.csv, row 1: column 3 has no name. Name it or remove it."],
    ),
    "missing column": (
        "pv.csv",
        "id,customer,p_max_kw,s_max_kva",
        "id,customer,p_max,s_max_kva",
        [
            "pv.csv, p_max_kw: the column is missing. Give the largest active power in kW.",
            "pv.csv, p_max: is not a known column. Did you mean p_max_kw?",
        ],
    ),
    "no known column": (
        "pv.csv",
        "id,customer,p_max_kw,s_max_kva",
        "1,2,3,4",
        [
            f"pv.csv, {name}: the column is missing. Give the {what}."
            for name, what in [
                ("id", "identifier of the PV system"),
                ("p_max_kw", "largest active power in kW"),
                ("s_max_kva", "inverter rating in kVA"),
            ]
        ]
        + [
            f"pv.csv, {name}: is not a known column. Remove it. "
            "Known: id, customer, p_max_kw, s_max_kva, kind, bus."
            for name in "1234"
        ],
    ),
    # lines
    "no line": (
        "lines.csv",
        "1,2,0.3,0.2\n2,3,0.4,0.3\n2,4,0.5,0.4\n",
        "",
        ["lines.csv: has no line. Give at least one line."],
    ),
    "resistance of zero": (
        "lines.csv",
        "1,2,0.3,0.2",
        "1,2,0,0.2",
        ["lines.csv, row 2, r_ohm = 0: must be at least 1e-07. Give the series resistance in ohm."],
    ),
    "reactance of an insulator": (
        "lines.csv",
        "1,2,0.3,0.2",
        "1,2,0.3,-2e4",
        [
            "lines.csv, row 2, x_ohm = -2e4: must be at least -10000. Give the series reactance "
            "(negative: a series capacitor, or a winding of a star) in ohm."
        ],
    ),
    "ratio of a voltage level": (
        "lines.csv",
        "from_bus,to_bus,r_ohm,x_ohm\n1,2,0.3,0.2\n2,3,0.4,0.3\n2,4,0.5,0.4",
        "from_bus,to_bus,r_ohm,x_ohm,ratio\n1,2,0.3,0.2,27.5\n2,3,0.4,0.3,\n2,4,0.5,0.4,1",
        [
            "lines.csv, row 2, ratio = 27.5: must be at most 10. Give the voltage in pu at "
            "from_bus over that at to_bus at no load: an ideal transformer at from_bus, with the "
            "line's impedance and charging behind it."
        ],
    ),
    "line without end": (
        "lines.csv",
        "2,4,0.5,0.4",
        "2,,0.5,0.4",
        [
            "lines.csv, row 4, to_bus: is empty. Give the bus at the other end of the line.",
            "customers.csv, row 4, bus = 4: is not a bus of lines.csv. Correct the bus. "
            "Known: 1, 2, 3.",
            "batteries.csv, row 3, bus = 4: is not a bus of lines.csv. Correct the bus. "
            "Known: 1, 2, 3.",
        ],
    ),
    "loop, after a blank line": (
        "lines.csv",
        "2,4,0.5,0.4",
        "2,4,0.5,0.4\n\n3,4,0.1,0.1",
        [
            "lines.csv, row 6, to_bus = 4: closes a loop: 4 - 2 - 3. "
            "The network must be radial: open (remove) one line of the loop."
        ],
    ),
    "island": (
        "lines.csv",
        "2,4,0.5,0.4",
        "2,4,0.5,0.4\n7,8,0.1,0.1",
        [
            "lines.csv: the network is disconnected: no path from the slack bus to bus 7, 8. "
            "Add the missing line or remove these buses."
        ],
    ),
    # customers
    "no customer": (
        "customers.csv",
        "hospital,2,critical,0.95\nshop,3,high,0.9\nhomes,4,low,0.98\n",
        "",
        [
            "customers.csv: has no row. Give at least one customer: without any there is nothing to "
            "serve.",
            "pv.csv, row 2, customer = hospital: is not a customer of customers.csv. "
            "Correct the customer.",
            "pv.csv, row 3, customer = homes: is not a customer of customers.csv. "
            "Correct the customer.",
            "load_kw.csv, hospital: is not a known column. Remove it.",
            "load_kw.csv, shop: is not a known column. Remove it.",
            "load_kw.csv, homes: is not a known column. Remove it.",
        ],
    ),
    "unknown bus": (
        "customers.csv",
        "shop,3,",
        "shop,33,",
        ["customers.csv, row 3, bus = 33: is not a bus of lines.csv. Did you mean 3?"],
    ),
    "unknown tier": (
        "customers.csv",
        "critical",
        "critcal",
        [
            "customers.csv, row 2, tier = critcal: is not a tier of scenario.toml. "
            "Did you mean critical?"
        ],
    ),
    "power factor above one": (
        "customers.csv",
        "high,0.9",
        "high,1.1",
        [
            "customers.csv, row 3, power_factor = 1.1: must be at most 1. "
            "Give the power factor of the load (negative: leading)."
        ],
    ),
    "power factor in words": (
        "customers.csv",
        "high,0.9",
        "high,good",
        [
            "customers.csv, row 3, power_factor = good: is not a number. "
            "Give the power factor of the load (negative: leading)."
        ],
    ),
    "weight of zero": (
        "customers.csv",
        "power_factor\nhospital,2,critical,0.95\nshop,3,high,0.9\nhomes,4,low,0.98",
        "power_factor,weight\nhospital,2,critical,0.95,\nshop,3,high,0.9,0\nhomes,4,low,0.98,2",
        [
            "customers.csv, row 3, weight = 0: must be at least 1e-06. "
            "Give the priority weight (empty: the weight of the tier)."
        ],
    ),
    "no part at all": (
        "customers.csv",
        "power_factor\nhospital,2,critical,0.95\nshop,3,high,0.9\nhomes,4,low,0.98",
        "power_factor,shed_steps\nhospital,2,critical,0.95,\nshop,3,high,0.9,0\n"
        "homes,4,low,0.98,2.5",
        [
            "customers.csv, row 3, shed_steps = 0: must be at least 1. Give the number of equal parts "
            "of the customer that may be switched off one by one; 1 is all or nothing.",
            "customers.csv, row 4, shed_steps = 2.5: is not a whole number. Give the number of equal "
            "parts of the customer that may be switched off one by one; 1 is all or nothing.",
        ],
    ),
    "reserved identifier": (
        "customers.csv",
        "shop,",
        "time,",
        [
            "customers.csv, row 3, id = time: is reserved for the time column. "
            "Choose another identifier.",
            "load_kw.csv, shop: is not a known column. Remove it.",
        ],
    ),
    # PV systems
    "identifier twice": (
        "pv.csv",
        "field,",
        "roof,",
        [
            "pv.csv, row 3, id = roof: is already used in row 2. Give each row its own identifier.",
            "pv_kw.csv, field: is not a known column. Remove it.",
        ],
    ),
    "unknown customer": (
        "pv.csv",
        "roof,hospital",
        "roof,hopsital",
        [
            "pv.csv, row 2, customer = hopsital: is not a customer of customers.csv. "
            "Did you mean hospital?"
        ],
    ),
    "PV without customer": (
        "pv.csv",
        "roof,hospital",
        "roof,",
        [
            "pv.csv, row 2, id = roof: has neither a customer nor a bus. Give the customer that owns "
            "it, or the bus at which it stands alone."
        ],
    ),
    "PV with a customer and a bus": (
        "pv.csv",
        "id,customer,p_max_kw,s_max_kva\nroof,hospital,30.0,40.0\nfield,homes,20.0,30.0",
        "id,customer,bus,p_max_kw,s_max_kva\nroof,hospital,2,30.0,40.0\nfield,,9,20.0,30.0",
        [
            "pv.csv, row 2, bus = 2: has a customer too. Leave one of them empty: a system is at its "
            "customer's bus, or stands alone.",
            "pv.csv, row 3, bus = 9: is not a bus of lines.csv. Correct the bus. Known: 1, 2, 3, 4.",
        ],
    ),
    "two PV systems of one customer": (
        "pv.csv",
        "field,homes",
        "field,hospital",
        [
            "pv.csv, row 3, customer = hospital: already has the PV system of row 2. "
            "Join the two systems: a customer has at most one."
        ],
    ),
    "PV larger than its inverter": (
        "pv.csv",
        "30.0,40.0",
        "50.0,40.0",
        [
            "pv.csv, row 2, p_max_kw = 50.0: must not exceed s_max_kva (40). Give the larger "
            "inverter, or cap p_max_kw and the series at its rating."
        ],
    ),
    "negative PV rating": (
        "pv.csv",
        "30.0,40.0",
        "-5,40.0",
        [
            "pv.csv, row 2, p_max_kw = -5: must be at least 0.001. "
            "Give the largest active power in kW."
        ],
    ),
    # batteries
    "battery without power": (
        "batteries.csv",
        "big,2,100.0,50.0",
        "big,2,100.0,0",
        [
            "batteries.csv, row 2, p_max_kw = 0: must be at least 0.001. "
            "Give the largest charging and discharging power in kW."
        ],
    ),
    "battery larger than its inverter": (
        "batteries.csv",
        "big,2,100.0,50.0",
        "big,2,100.0,70",
        [
            "batteries.csv, row 2, p_max_kw = 70.0: must not exceed s_max_kva (60). "
            "Correct the power or the inverter rating."
        ],
    ),
    "battery at no bus": (
        "batteries.csv",
        "small,4,",
        "small,,",
        ["batteries.csv, row 3, bus: is empty. Give the bus of the battery."],
    ),
    "battery at an unknown bus": (
        "batteries.csv",
        "small,4,",
        "small,north,",
        [
            "batteries.csv, row 3, bus = north: is not a bus of lines.csv. Correct the bus. "
            "Known: 1, 2, 3, 4."
        ],
    ),
    "state of charge in per cent": (
        "batteries.csv",
        "35.0,0.15,0.85",
        "35.0,0.15,85",
        [
            "batteries.csv, row 3, soc_max = 85: must be at most 1. "
            "Give the highest state of charge."
        ],
    ),
    "state of charge limits crossed": (
        "batteries.csv",
        "35.0,0.15,0.85",
        "35.0,0.85,0.85",
        [
            "batteries.csv, row 3, soc_min = 0.85: must be less than soc_max (0.85). "
            "Correct one of the limits."
        ],
    ),
    "start outside the state of charge limits": (
        "batteries.csv",
        "0.85,0.5,",
        "0.85,0.1,",
        [
            "batteries.csv, row 3, soc_initial = 0.1: must lie between soc_min (0.15) and soc_max "
            "(0.85). Correct the state of charge at the start or the limits."
        ],
    ),
    "efficiency above one": (
        "batteries.csv",
        "0.5,0.95,",
        "0.5,1.05,",
        [
            "batteries.csv, row 3, eta_charge = 1.05: must be at most 1. "
            "Give the charging efficiency."
        ],
    ),
    "infinite energy": (
        "batteries.csv",
        "big,2,100.0,",
        "big,2,inf,",
        [
            "batteries.csv, row 2, energy_kwh = inf: is not a finite number. "
            "Give the energy capacity in kWh."
        ],
    ),
    # series: time
    "missing step": (
        "load_kw.csv",
        "2022-07-19T12:00:00Z,64.0,42.0,47.0\n",
        "",
        ["load_kw.csv, time = 2022-07-19T12:00:00Z: this step is missing. Add its row."],
    ),
    "step twice": (
        "load_kw.csv",
        "2022-07-19T12:00:00Z",
        "2022-07-19T11:00:00Z",
        [
            "load_kw.csv, time = 2022-07-19T12:00:00Z: this step is missing. Add its row.",
            "load_kw.csv, row 4, time = 2022-07-19T11:00:00Z: is a duplicate of row 3. "
            "Remove one of the two rows.",
        ],
    ),
    "row of another day": (
        "load_kw.csv",
        "2022-07-19T15:00:00Z",
        "2022-07-20T15:00:00Z",
        [
            "load_kw.csv, time = 2022-07-19T15:00:00Z: this step is missing. Add its row.",
            "load_kw.csv, row 7, time = 2022-07-20T15:00:00Z: is not a step of the scenario. "
            + GRID_CURE,
        ],
    ),
    "another step length": (
        "scenario.toml",
        "step_minutes = 60.0\nsteps = 6",
        "step_minutes = 30.0\nsteps = 12",
        [
            f"{file}, time: the rows are 60 min apart. The scenario's steps begin at "
            "2022-07-19T10:00:00Z and last 30 min; there are 12."
            for file in ("load_kw.csv", "pv_kw.csv", "system.csv")
        ],
    ),
    "rows swapped": (
        "system.csv",
        "2022-07-19T11:00:00Z,0.28,30.0\n2022-07-19T12:00:00Z,0.32,32.0",
        "2022-07-19T12:00:00Z,0.32,32.0\n2022-07-19T11:00:00Z,0.28,30.0",
        ["system.csv, row 4, time = 2022-07-19T11:00:00Z: is out of order. Sort the rows by time."],
    ),
    "time without zone": (
        "system.csv",
        "2022-07-19T12:00:00Z",
        "2022-07-19T12:00:00",
        [
            "system.csv, row 4, time = 2022-07-19T12:00:00: has no time zone. "
            "Add the offset, for example 2022-07-19T12:00:00Z."
        ],
    ),
    "time in another notation": (
        "system.csv",
        "2022-07-19T12:00:00Z",
        "19/07/2022 12:00",
        [
            "system.csv, row 4, time = 19/07/2022 12:00: is not an ISO 8601 time. "
            "Write it like 2022-07-19T12:00:00Z."
        ],
    ),
    "time as a word": (
        "system.csv",
        "2022-07-19T12:00:00Z",
        "now",
        [
            "system.csv, row 4, time = now: is not an ISO 8601 time. "
            "Write it like 2022-07-19T12:00:00Z."
        ],
    ),
    "time is empty": (
        "system.csv",
        "2022-07-19T12:00:00Z",
        "",
        ["system.csv, row 4, time: is empty. Write it like 2022-07-19T12:00:00Z."],
    ),
    "no time column": (
        "system.csv",
        "time,",
        "hour,",
        [
            "system.csv, time: the column is missing. "
            "Give the beginning of the step, ISO 8601 with time zone.",
            "system.csv, hour: is not a known column. Remove it. Known: time, grid_limit_kw, "
            "export_limit_kw, export_price_gbp_per_kwh.",
        ],
    ),
    "no time column beside the customers": (
        "load_kw.csv",
        "time,",
        "hour,",
        [
            "load_kw.csv, time: the column is missing. "
            "Give the beginning of the step, ISO 8601 with time zone.",
            "load_kw.csv, hour: is not a known column. Remove it. Known: time.",
        ],
    ),
    # series: columns and numbers
    "load of no customer": (
        "load_kw.csv",
        "hospital,shop,homes",
        "hospital,shopp,homes",
        [
            "load_kw.csv, shop: the column is missing. "
            "Add one column per customer of customers.csv.",
            "load_kw.csv, shopp: is not a known column. Did you mean shop?",
        ],
    ),
    "empty cell": (
        "load_kw.csv",
        "64.0,42.0,47.0",
        "64.0,,47.0",
        ["load_kw.csv, row 4, shop: is empty. Give the demand of the customer if served in kW."],
    ),
    "not-a-number cell": (
        "load_kw.csv",
        "64.0,42.0,47.0",
        "64.0,nan,47.0",
        [
            "load_kw.csv, row 4, shop = nan: is not a number. "
            "Give the demand of the customer if served in kW."
        ],
    ),
    "word in a cell": (
        "load_kw.csv",
        "64.0,42.0,47.0",
        "64.0,n/a,47.0",
        [
            "load_kw.csv, row 4, shop = n/a: is not a number. "
            "Give the demand of the customer if served in kW."
        ],
    ),
    "infinite load": (
        "load_kw.csv",
        "64.0,42.0,47.0",
        "64.0,inf,47.0",
        [
            "load_kw.csv, row 4, shop = inf: is not a finite number. "
            "Give the demand of the customer if served in kW."
        ],
    ),
    "negative load": (
        "load_kw.csv",
        "64.0,42.0,47.0",
        "64.0,-42.0,47.0",
        [
            "load_kw.csv, row 4, shop = -42.0: must be at least 0. "
            "Give the demand of the customer if served in kW."
        ],
    ),
    "PV above its rating": (
        "pv_kw.csv",
        "28.0,19.0",
        "30.04,19.0",
        [
            "pv_kw.csv, row 3, roof = 30.04: exceeds the system's p_max_kw (30). "
            "Correct the series or the rating."
        ],
    ),
    "price in another unit": (
        "system.csv",
        "0.32,32.0",
        "-32000,32.0",
        [
            "system.csv, row 4, price_gbp_per_kwh = -32000: must be at least -10000. "
            "Give the import price (negative: the feeder is paid) in GBP/kWh."
        ],
    ),
    "temperature in kelvin": (
        "system.csv",
        "0.32,32.0",
        "0.32,305.0",
        [
            "system.csv, row 4, temperature_c = 305.0: must be at most 60. "
            "Give the ambient temperature in °C."
        ],
    ),
    "mistakes in several files": (
        "customers.csv",
        "hospital,2,critical,0.95\nshop,3,high,0.9",
        "hospital,2,critical,0\nclinic,5,high,0.9",
        [
            "customers.csv, row 2, power_factor = 0: must be at least 0.01, or at most -0.01 "
            "where the load feeds reactive power. "
            "Give the power factor of the load (negative: leading).",
            "customers.csv, row 3, bus = 5: is not a bus of lines.csv. Correct the bus. "
            "Known: 1, 2, 3, 4.",
            "load_kw.csv, clinic: the column is missing. "
            "Add one column per customer of customers.csv.",
            "load_kw.csv, shop: is not a known column. Remove it. Known: clinic.",
        ],
    ),
}


def messages(folder: Path) -> list[str]:
    """What reading a folder complains about."""
    with pytest.raises(InputError) as caught:
        read_scenario(folder)
    return str(caught.value).split("\n")


def edit(folder: Path, file: str, old: str, new: str) -> None:
    """Replace the first occurrence of a text that must be there."""
    text = (folder / file).read_text(encoding="utf-8")
    assert old in text
    (folder / file).write_text(text.replace(old, new, 1), encoding="utf-8")


@pytest.mark.parametrize("case", EDITS)
def test_message(tiny_folder: Path, case: str) -> None:
    file, old, new, expected = EDITS[case]
    edit(tiny_folder, file, old, new)
    assert messages(tiny_folder) == expected


def test_negative_grid_limit_is_refused_and_infinite_is_not(tiny_folder: Path) -> None:
    limits = ["inf", "120", "-1", "0", "-inf", "inf"]
    lines = (tiny_folder / "system.csv").read_text(encoding="utf-8").split()
    rows = [f"{line},{cell}" for line, cell in zip(lines, ["grid_limit_kw", *limits], strict=True)]
    (tiny_folder / "system.csv").write_text("\n".join(rows), encoding="utf-8")
    cure = "Give the largest import from the grid (inf, or no such column: no limit) in kW."
    assert messages(tiny_folder) == [
        f"system.csv, row 4, grid_limit_kw = -1: must be at least 0. {cure}",
        f"system.csv, row 6, grid_limit_kw = -inf: is not a finite number. {cure}",
    ]


@pytest.mark.parametrize(
    "file", ["lines.csv", "customers.csv", "load_kw.csv", "pv_kw.csv", "system.csv"]
)
def test_missing_file(tiny_folder: Path, file: str) -> None:
    (tiny_folder / file).unlink()
    assert messages(tiny_folder) == [f"{file}: the file is missing. {FILE_CURE}"]


def test_missing_scenario_file(tiny_folder: Path) -> None:
    (tiny_folder / "scenario.toml").unlink()
    assert messages(tiny_folder) == [
        "scenario.toml: the file is missing. A scenario folder needs it: see the page on the "
        "scenario format."
    ]


def test_empty_file(tiny_folder: Path) -> None:
    (tiny_folder / "lines.csv").write_text("", encoding="utf-8")
    assert messages(tiny_folder) == ["lines.csv: is empty. Write a header row with column names."]


def test_series_without_rows(tiny_folder: Path) -> None:
    (tiny_folder / "pv_kw.csv").write_text("time,roof,field\n", encoding="utf-8")
    assert messages(tiny_folder) == [f"pv_kw.csv: has no row. {GRID_CURE}"]


@pytest.mark.parametrize("file", ["lines.csv", "scenario.toml"])
def test_wrong_encoding(tiny_folder: Path, file: str) -> None:
    (tiny_folder / file).write_bytes(b"name,caf\xc3\xa9\nx,caf\xe9\n")
    assert messages(tiny_folder) == [
        f"{file}, row 2: is not UTF-8 text (byte 0xe9). Save the file with UTF-8 encoding."
    ]


def test_broken_parquet(tiny_folder: Path) -> None:
    edit(
        tiny_folder,
        "scenario.toml",
        "[controller]",
        '[files]\nload_kw = "load_kw.parquet"\n[controller]',
    )
    (tiny_folder / "load_kw.parquet").write_bytes(b"time,hospital\n")
    found = messages(tiny_folder)
    assert len(found) == 1
    assert found[0].startswith("load_kw.parquet: is not a readable Parquet file (")
    assert found[0].endswith("). Write the file again.")


def test_parquet_with_lists_in_its_cells(tiny_folder: Path) -> None:
    frame = pd.read_csv(tiny_folder / "customers.csv")
    frame["bus"] = [[bus] for bus in frame["bus"]]
    frame.to_parquet(tiny_folder / "customers.parquet", index=False)
    edit(
        tiny_folder,
        "scenario.toml",
        "[controller]",
        '[files]\ncustomers = "customers.parquet"\n[controller]',
    )
    assert messages(tiny_folder)[0] == (
        "customers.parquet, bus: holds lists or tables. Write one number a cell."
    )


def test_what_pandas_notes_in_parquet_files_is_not_needed(tiny_folder: Path) -> None:
    before = read_scenario(tiny_folder)
    table = pa.Table.from_pandas(pd.read_csv(tiny_folder / "customers.csv"))
    note = {b"pandas": b'{"index_columns": ["none"], "column_indexes": 3, "columns": [[1]]}'}
    pq.write_table(table.replace_schema_metadata(note), tiny_folder / "customers.parquet")
    edit(
        tiny_folder,
        "scenario.toml",
        "[controller]",
        '[files]\ncustomers = "customers.parquet"\n[controller]',
    )
    assert scenario_digest(read_scenario(tiny_folder)) == scenario_digest(before)


@pytest.mark.parametrize("length", [200, 5000])
@pytest.mark.parametrize(
    "ask", [find_scenario, import_network, lambda name: RunOptions(controller=name)]
)
def test_long_names_are_cut_in_messages(ask: Callable[[str], object], length: int) -> None:
    with pytest.raises(InputError) as caught:
        ask("x" * length)
    assert len(str(caught.value)) < 600
    assert "x" * 200 in str(caught.value)


def test_parquet_times_without_zone_and_missing_values(tiny_folder: Path) -> None:
    frame = pd.read_csv(tiny_folder / "load_kw.csv", parse_dates=["time"])
    frame["time"] = frame["time"].dt.tz_localize(None)
    frame.loc[2, "shop"] = None
    frame.to_parquet(tiny_folder / "load_kw.parquet", index=False)
    edit(
        tiny_folder,
        "scenario.toml",
        "[controller]",
        '[files]\nload_kw = "load_kw.parquet"\n[controller]',
    )
    found = messages(tiny_folder)
    assert found[0] == (
        "load_kw.parquet, row 2, time = 2022-07-19 10:00:00: has no time zone. "
        "Add the offset, for example 2022-07-19 10:00:00Z."
    )
    assert (
        "load_kw.parquet, row 4, shop: is empty. Give the demand of the customer if served in kW."
    ) in found
    assert len(found) == 7


def test_missing_folder(tmp_path: Path) -> None:
    folder = tmp_path / "nowhere"
    assert messages(folder) == [
        f"{folder}: there is no such folder. Give the path of a scenario folder."
    ]


def test_file_instead_of_folder(tiny_folder: Path) -> None:
    file = tiny_folder / "scenario.toml"
    assert messages(file) == [f"{file}: is not a folder. Give the path of a scenario folder."]


def test_all_files_are_reported_at_once_by_file_and_row(tiny_folder: Path) -> None:
    edit(tiny_folder, "system.csv", "0.45,33.0", "0.45,hot")
    edit(tiny_folder, "system.csv", "0.3,28.0", "dear,28.0")
    edit(tiny_folder, "lines.csv", "0.4,0.3", "0,0.3")
    edit(tiny_folder, "scenario.toml", "low = 0.02", "low = -1")
    places = [message.split(" = ")[0] for message in messages(tiny_folder)]
    assert places == [
        "scenario.toml, tiers.low",
        "lines.csv, row 3, r_ohm",
        "system.csv, row 2, price_gbp_per_kwh",
        "system.csv, row 7, temperature_c",
    ]


def test_tables_are_checked_even_if_the_scenario_file_cannot_be_read(tiny_folder: Path) -> None:
    (tiny_folder / "scenario.toml").write_text("name = ", encoding="utf-8")
    edit(tiny_folder, "pv.csv", "roof,hospital", "roof,hotel")
    assert [message.split(":")[0] for message in messages(tiny_folder)] == [
        "scenario.toml, row 1",
        "pv.csv, row 2, customer = hotel",
    ]


def test_problems_of_one_kind_are_folded(tiny_folder: Path) -> None:
    rows = "".join(f"{i},{i},high,2\n" for i in range(60))
    (tiny_folder / "customers.csv").write_text(
        "id,bus,tier,power_factor\n" + rows, encoding="utf-8"
    )
    found = [m for m in messages(tiny_folder) if m.startswith("customers.csv")]
    # 60 power factors and 56 buses (0 and 5 to 59) are wrong.
    assert len(found) == 2 * MAX_PROBLEMS_PER_KIND
    assert [m for m in found if " more" in m] == [
        "customers.csv, row 11, power_factor = 2: must be at most 1, and 50 more. "
        "Give the power factor of the load (negative: leading).",
        "customers.csv, row 15, bus = 13: is not a bus of lines.csv, and 46 more. Did you mean 3?",
    ]


def test_very_many_kinds_of_problems_are_counted(tiny_folder: Path) -> None:
    """Sixty problems of ten batteries: six cells in each row are wrong."""
    names = ["eta_charge", "eta_discharge", "r_int_ohm", "beta_per_c", "u_batt_v", "t_ref_c"]
    rows = "".join(f"b{i},2,10,5,6,{','.join(['x'] * 6)}\n" for i in range(10))
    (tiny_folder / "batteries.csv").write_text(
        f"id,bus,energy_kwh,p_max_kw,s_max_kva,{','.join(names)}\n{rows}", encoding="utf-8"
    )
    found = messages(tiny_folder)
    assert len(found) == MAX_PROBLEMS_PER_FILE + 1
    assert found[-1] == "batteries.csv: has 10 more problems. Fix those above first."


def test_many_columns_with_wrong_names_are_refused_quickly(tiny_folder: Path) -> None:
    count = 800
    customers = "".join(f"customer_number_{i:05},2,high,0.9\n" for i in range(count))
    (tiny_folder / "customers.csv").write_text(
        "id,bus,tier,power_factor\n" + customers, encoding="utf-8"
    )
    header = "".join(f",customer-nomber-{i:05}" for i in range(count))
    rows = "".join(f"2022-07-19T{hour}:00:00Z{',1' * count}\n" for hour in range(10, 16))
    (tiny_folder / "load_kw.csv").write_text(f"time{header}\n{rows}", encoding="utf-8")
    with processor_s_below(5.0):  # 45 s when every name was compared with every other
        found = [m for m in messages(tiny_folder) if m.startswith("load_kw.csv")]
    assert found[9] == (
        "load_kw.csv, customer_number_00009: the column is missing, and 790 more. "
        "Add one column per customer of customers.csv."
    )
    assert found[-1] == (
        "load_kw.csv, customer-nomber-00009: is not a known column, and 790 more. "
        "Did you mean customer_number_00009?"
    )


def test_a_file_without_end_is_refused_by_its_size(tiny_folder: Path) -> None:
    with (tiny_folder / "load_kw.csv").open("wb") as file:
        file.truncate(200_000_000)
    with processor_s_below(2.0):
        found = messages(tiny_folder)
    assert found == [
        "load_kw.csv: is too large, more than 100 MB. Give longer or fewer steps, or fewer columns."
    ]


SIZES = (
    "is too large, more than 527041 rows, 10001 columns or 10000000 cells. "
    "Give longer or fewer steps, or fewer columns."
)


def test_tables_beyond_any_feeder_are_refused(tiny_folder: Path) -> None:
    (tiny_folder / "load_kw.csv").write_text("time\n" + "x\n" * 527_041, encoding="utf-8")
    (tiny_folder / "pv_kw.csv").write_text("time" + ",x" * 10_001 + "\n", encoding="utf-8")
    (tiny_folder / "customers.csv").write_text(
        "id,bus,tier,power_factor\n" + "a,2,high,0.9\n" * 10_001, encoding="utf-8"
    )
    found = messages(tiny_folder)
    assert found[:1] == [
        "customers.csv: has 10001 rows, more than 10000. Reduce the feeder, or "
        "split it at its substation."
    ]
    assert found[-2:] == [f"load_kw.csv: {SIZES}", f"pv_kw.csv: {SIZES}"]


def test_a_small_parquet_file_with_very_many_rows_is_refused_unread(tiny_folder: Path) -> None:
    file = tiny_folder / "load_kw.parquet"
    pd.DataFrame({"time": np.zeros(600_000), "hospital": 0.0}).to_parquet(file)
    edit(
        tiny_folder,
        "scenario.toml",
        "[controller]",
        '[files]\nload_kw = "load_kw.parquet"\n[controller]',
    )
    assert file.stat().st_size < 100_000
    assert messages(tiny_folder) == [f"load_kw.parquet: {SIZES}"]


# --- numbers that no equipment has --------------------------------------------------------------


@pytest.mark.parametrize(
    ("table", "field", "value", "message"),
    [
        ("batteries.csv", "energy_kwh", "1e308", "must be at most 1e+06"),
        ("batteries.csv", "eta_charge", "1e-300", "must be at least 0.01"),
        ("lines.csv", "r_ohm", "1e15", "must be at most 10000"),
        ("lines.csv", "r_ohm", "1e-300", "must be at least 1e-07"),
        ("customers.csv", "weight", "1e308", "must be at most 1e+06"),
        ("pv.csv", "p_max_kw", "1e308", "must be at most 1e+06"),
        ("load_kw.csv", "shop", "1e308", "must be at most 1e+06"),
        ("system.csv", "price_gbp_per_kwh", "-1e308", "must be at least -10000"),
    ],
)
def test_numbers_that_no_equipment_has_are_refused(
    tiny_folder: Path, table: str, field: str, value: str, message: str
) -> None:
    frame = pd.read_csv(tiny_folder / table, dtype=str)
    frame[field] = frame.get(field, "1")
    frame.loc[1, field] = value
    frame.to_csv(tiny_folder / table, index=False)
    found = messages(tiny_folder)
    assert found[0].startswith(f"{table}, row 3, {field} = {value}: {message}. Give the ")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"load_kw": np.full((6, 3), 1e308)},
            "load_kw, row 0, load_kw = 1e+308: must lie between 0 and 1e+06",
        ),
        (
            {"price_gbp_per_kwh": np.full(6, np.nan)},
            "system, row 0, price_gbp_per_kwh = nan: must lie between -10000 and 10000",
        ),
        (
            {"title": "a\x1b[2J"},
            "scenario, title = a\\x1b[2J: holds the character U+001B, which cannot be shown",
        ),
    ],
)
def test_python_has_the_same_door_as_files(change: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError) as caught:
        check_scenario(replace(tiny_scenario(), **change))
    assert str(caught.value).splitlines()[0].startswith(message)


@pytest.mark.parametrize(("soc", "read"), [(0.15 - 1e-7, 0.15), (0.85 + 9e-7, 0.85)])
def test_a_rounding_error_of_the_state_of_charge_is_clipped_with_a_note(
    tiny_folder: Path, soc: float, read: float
) -> None:
    edit(tiny_folder, "batteries.csv", "0.85,0.5,", f"0.85,{soc!r},")
    batteries = read_scenario(tiny_folder).batteries
    assert batteries.soc_initial.tolist() == [0.15, read]
    assert batteries.notes == (
        f"The state of charge of battery small at the start, {soc:.9g}, is a rounding error "
        f"outside its limits: {read} is used.",
    )


@pytest.mark.parametrize("soc", [0.15 - 2e-6, 0.9, float("nan")])
def test_a_state_of_charge_outside_its_limits_is_refused_by_name(soc: float) -> None:
    with pytest.raises(InputError) as caught:
        replace(tiny_scenario().batteries, soc_initial=[0.15, soc])
    assert str(caught.value) == (
        f"battery small, soc_initial = {soc}: must lie between soc_min (0.15) and soc_max (0.85). "
        "Correct the state of charge at the start or the limits."
    )


# --- names ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "message"),
    [
        (
            '"a\x1b[2J"',
            "id = a\\x1b[2J: holds the character U+001B, which cannot be shown. "
            "Write it with characters that can be seen.",
        ),
        (
            '"a\nb"',
            "id = a\\nb: holds the character U+000A, which cannot be shown. "
            "Write it with characters that can be seen.",
        ),
        (
            "a\x00",
            "id = a\\x00: holds the character U+0000, which cannot be shown. "
            "Write it with characters that can be seen.",
        ),
        (
            "\u202eabc",
            "id = \\u202eabc: holds the character U+202E, which cannot be shown. "
            "Write it with characters that can be seen.",
        ),
        (
            "=1+1",
            "id = =1+1: begins with '='. Begin it with another character: spreadsheets take such "
            "a cell for a formula.",
        ),
        ("x" * 101, f"id = {'x' * 60}...: is longer than 100 characters. Shorten it."),
    ],
)
def test_names_that_cannot_be_shown_are_refused(tiny_folder: Path, name: str, message: str) -> None:
    edit(tiny_folder, "batteries.csv", "small,", f"{name},")
    assert messages(tiny_folder) == [f"batteries.csv, row {3 + name.count(chr(10))}, {message}"]


def test_the_name_of_a_tier_and_the_title_are_checked(tiny_folder: Path) -> None:
    edit(tiny_folder, "scenario.toml", "low = 0.02", '"a\\u0000" = 0.02\nlow = 0.02')
    edit(tiny_folder, "scenario.toml", 'title = "', 'title = "\\u001b')
    assert messages(tiny_folder) == [
        "scenario.toml, title = \\x1bFour buses, six hours: holds the character U+001B, which "
        "cannot be shown. Write it with characters that can be seen.",
        "scenario.toml, tiers.a\\x00 = a\\x00: holds the character U+0000, which cannot be shown. "
        "Write it with characters that can be seen.",
    ]


@pytest.fixture(scope="module")
def valid_texts(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The files of the tiny folder."""
    folder = tmp_path_factory.mktemp("valid") / "tiny"
    write_scenario(tiny_scenario(), folder)
    return {file: (folder / file).read_text(encoding="utf-8") for file in FILES}


PLACE = st.floats(0, 1)
"""A share of a text's characters or rows, whatever its length."""

EDIT = st.tuples(
    st.sampled_from(FILES),
    PLACE,
    st.integers(0, MOST_CUT),
    st.sampled_from(SNIPPETS) | st.text(max_size=6),
)
ROW_EDIT = st.tuples(st.sampled_from(FILES), PLACE, PLACE, st.sampled_from(ROW_EDITS))


def edited(text: str, place: float, extent: float | int, what: str) -> str:
    """A text with some characters replaced, or one of its rows moved."""
    if isinstance(extent, int):
        return with_snippet(text, int(place * len(text)), extent, what)
    last = len(text.splitlines()) - 1
    return text if last < 0 else with_row(text, round(place * last), round(extent * last), what)


@pytest.mark.daily
def test_any_mutation_is_read_or_refused_with_reasons(
    valid_texts: dict[str, str], tmp_path: Path, pytestconfig: pytest.Config
) -> None:
    @settings(max_examples=pytestconfig.getoption("fuzz"), deadline=None, derandomize=True)
    @given(edits=st.lists(EDIT | ROW_EDIT, min_size=1, max_size=3))
    def read_mutated(edits: list[tuple[str, float, float | int, str]]) -> None:
        texts = dict(valid_texts)
        for file, place, extent, what in edits:
            texts[file] = edited(texts[file], place, extent, what)
        for file, text in texts.items():
            (tmp_path / file).write_text(
                text, encoding="utf-8", errors="surrogateescape", newline=""
            )
        check_reading(tmp_path)

    read_mutated()


def check_reading(folder: Path) -> None:
    """A folder is read, or refused with places and cures; anything else is an error."""
    try:
        scenario = read_scenario(folder)
    except InputError as error:
        assert all(problem.cure and problem.where for problem in error.problems)
    else:
        assert scenario.load_kw.shape == (scenario.grid.n_steps, len(scenario.customers))
        assert scenario.pv_kw.shape == (scenario.grid.n_steps, len(scenario.pv))


def test_what_is_read_of_mutated_folders_runs_to_the_end(tiny_folder: Path) -> None:
    """A small part of the study; see experiments/mutations.py for the large one."""
    tally = study(tiny_folder, folders=40, runs=1, seed=2)
    assert tally.sound, tally
    assert tally.runs["finished"] >= 1
    assert tally.refused > 13
