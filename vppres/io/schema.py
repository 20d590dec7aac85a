"""The table of attributes: every column and key that a scenario folder may hold.

Each field states its unit, meaning, bounds and default once. Defaults, checks, messages, the
documentation page and the JSON Schema are all derived from it.
"""

from __future__ import annotations

from math import inf
from typing import TYPE_CHECKING, Annotated, Any, Literal

from annotated_types import Ge, Le
from pydantic import AfterValidator, AwareDatetime, BaseModel, ConfigDict, Field, create_model
from pydantic.fields import FieldInfo
from pydantic_core import PydanticCustomError

from vppres.core.text import flaw_of_name
from vppres.scenario.network import Network
from vppres.scenario.option_table import Option, section_options
from vppres.scenario.outage_warnings import STATISTICS_PRESETS, WARNING_PRESETS
from vppres.scenario.scenario import DEFAULT_VOLL_GBP_PER_KWH, ObjectiveWeights
from vppres.scenario.source import MAX_NOTE_LENGTH, MAX_NOTES, MAX_SOURCE_LENGTH
from vppres.scenario.timegrid import UTC, is_zone

Unit = dict[str, Any]

KW: Unit = {"unit": "kW"}
KVA: Unit = {"unit": "kVA"}
KVAR: Unit = {"unit": "kvar"}
KWH: Unit = {"unit": "kWh"}
OHM: Unit = {"unit": "ohm"}
US: Unit = {"unit": "µS"}
PU: Unit = {"unit": "pu"}
CELSIUS: Unit = {"unit": "°C"}
PER_C2: Unit = {"unit": "1/°C²"}
GBP_PER_KWH: Unit = {"unit": "GBP/kWh"}
HOURS: Unit = {"unit": "h"}

MAX_GRID_DAYS = 366
MAX_STEPS = MAX_GRID_DAYS * 1440  # steps of a minute
MAX_SHED_STEPS = 20
MAX_ITEMS = 10_000  # lines, customers, ...: matrices of the network grow with the square
MAX_NAME_LENGTH = 100  # of an identifier: names of files and labels of figures are made of it
MAX_TITLE_LENGTH = 300

# Bounds that no equipment of a distribution feeder reaches. Values beyond them are mistakes of
# unit or of typing, and the sums and products of the solvers would lose their digits.
MIN_KW = 1e-3  # 1 W; what is smaller is not there
MAX_KW = 1e6  # 1 GW, a large power station; energy for an hour of it
MAX_KVAR = 1e6  # 1 Gvar, a large compensator
MIN_OHM = 1e-7  # a centimetre of busbar
MIN_RATIO = 0.1  # no tap changer leaves 30 % of the nominal voltage
MAX_RATIO = 10.0
MAX_US = 1e9  # 1 kS shorts any feeder
MAX_OHM = 1e4  # insulated rather than connected: 10,000 km of overhead line have 3,000 ohm
MAX_A = 1e6  # generator leads of the largest machines carry 4e4 A
MIN_KV = 0.05  # extra-low voltage ends here
MAX_KV = 1200.0  # the highest transmission voltage in service
MIN_PU = 0.1  # a voltage collapses long before
MIN_POWER_FACTOR = 0.01  # a load of hardly any active power; leading ones are negative
MIN_EFFICIENCY = 0.01
MAX_PRICE = 1e4  # 500 times the value of lost load, room for other currencies
MIN_WEIGHT = 1e-6  # the ratio of two customers' weights keeps within the digits of the solvers
MAX_WEIGHT = 1e6
MAX_LAMBDA = 1e3  # 1 kW or 1 GBP outweighs a thousand customers of weight 1
MIN_THERMAL = 1e-3  # 1 °C/MW, or a gram of steel
MAX_THERMAL = 1e3  # 1 °C/W, or a thousand tonnes of steel
MAX_LOSS_PER_C2 = 1.0  # everything is lost 1 °C away from the reference
MAX_CELL_OHM = 100.0  # a string of small cells has 1 ohm
MAX_OUTAGE_H = 8784.0  # a leap year
MAX_SAIFI = 8760.0  # one an hour
MAX_SIGMA = 5.0  # nine in ten outages differ by a factor of 400,000
MAX_BATTERY_V = 1e5  # strings in service stay below 2 kV
_FILE_NAME = r"^[^/\\]+\.(csv|parquet)$"


def _sound(longest: int) -> AfterValidator:
    """A check that a text can be shown, drawn and written as it is."""

    def check(text: str) -> str:
        flaw = flaw_of_name(text, longest)
        if flaw:
            message, cure = flaw
            raise PydanticCustomError(
                "flawed_name", "{message}", {"message": message, "cure": cure}
            )
        return text

    return AfterValidator(check)


Name = Annotated[str, _sound(MAX_NAME_LENGTH)]
Title = Annotated[str, _sound(MAX_TITLE_LENGTH)]
SourceName = Annotated[str, _sound(MAX_SOURCE_LENGTH)]
Note = Annotated[str, _sound(MAX_NOTE_LENGTH)]


def _known_zone(name: str) -> str:
    """Refuse what is no time zone."""
    if not is_zone(name):
        raise PydanticCustomError(
            "flawed_name",
            "{message}",
            {
                "message": "is not the name of a time zone",
                "cure": "Give one such as Europe/London, or leave the key out: UTC.",
            },
        )
    return name


def _active(power_factor: float) -> float:
    """A power factor of a load with active power."""
    if abs(power_factor) < MIN_POWER_FACTOR:
        raise PydanticCustomError(
            "flawed_number",
            "{message}",
            {
                "message": f"must be at least {MIN_POWER_FACTOR:g}, or at most "
                f"-{MIN_POWER_FACTOR:g} where the load feeds reactive power",
            },
        )
    return power_factor


class Row(BaseModel):
    """One row of a table; every cell arrives as text."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class LineRow(Row):
    """A line of the radial network."""

    from_bus: Name = Field(description="bus at one end of the line")
    to_bus: Name = Field(description="bus at the other end of the line")
    r_ohm: float = Field(
        ge=MIN_OHM, le=MAX_OHM, description="series resistance", json_schema_extra=OHM
    )
    x_ohm: float = Field(
        ge=-MAX_OHM,
        le=MAX_OHM,
        description="series reactance (negative: a series capacitor, or a winding of a star)",
        json_schema_extra=OHM,
    )
    i_max_a: float | None = Field(
        default=None,
        ge=MIN_KW,
        le=MAX_A,
        description="thermal rating for the report's line loading (empty: none)",
        json_schema_extra={"unit": "A"},
    )
    ratio: float = Field(
        default=1.0,
        ge=MIN_RATIO,
        le=MAX_RATIO,
        description="voltage in pu at from_bus over that at to_bus at no load: an ideal "
        "transformer at from_bus, with the line's impedance and charging behind it",
    )
    b_us: float = Field(
        default=0.0,
        ge=-MAX_US,
        le=MAX_US,
        description="charging susceptance of the whole line, half at each end",
        json_schema_extra=US,
    )
    g_us: float = Field(
        default=0.0,
        ge=-MAX_US,
        le=MAX_US,
        description="leakage conductance of the whole line, half at each end",
        json_schema_extra=US,
    )


class BusRow(Row):
    """What a bus draws that no customer owns; buses that draw nothing need no row."""

    bus: Name = Field(description="bus of the network")
    p_shunt_kw: float = Field(
        default=0.0,
        ge=-MAX_KW,
        le=MAX_KW,
        description="active power that the bus's shunt draws at 1 pu",
        json_schema_extra=KW,
    )
    q_shunt_kvar: float = Field(
        default=0.0,
        ge=-MAX_KVAR,
        le=MAX_KVAR,
        description="reactive power that the bus's shunt draws at 1 pu (negative: a capacitor)",
        json_schema_extra=KVAR,
    )
    p_fixed_kw: float = Field(
        default=0.0,
        ge=-MAX_KW,
        le=MAX_KW,
        description="constant active power drawn at the bus",
        json_schema_extra=KW,
    )
    q_fixed_kvar: float = Field(
        default=0.0,
        ge=-MAX_KVAR,
        le=MAX_KVAR,
        description="constant reactive power drawn at the bus",
        json_schema_extra=KVAR,
    )


class CustomerRow(Row):
    """A customer that is either served or switched off, or in equal parts."""

    id: Name = Field(description="identifier of the customer")
    bus: Name = Field(description="bus of the customer")
    tier: Name = Field(description="priority tier, one of scenario.toml's tiers")
    power_factor: Annotated[float, AfterValidator(_active)] = Field(
        ge=-1, le=1, description="power factor of the load (negative: leading)"
    )
    weight: float | None = Field(
        default=None,
        ge=MIN_WEIGHT,
        le=MAX_WEIGHT,
        description="priority weight (empty: the weight of the tier)",
    )
    shed_steps: int = Field(
        default=1,
        ge=1,
        le=MAX_SHED_STEPS,
        description="number of equal parts of the customer "
        "that may be switched off one by one; 1 is all or nothing",
    )


class PVRow(Row):
    """A PV system behind a customer's meter, or one that stands alone at a bus."""

    id: Name = Field(description="identifier of the PV system")
    customer: Name = Field(
        default="",
        description="customer that owns the PV system (empty: it stands alone at its `bus`)",
    )
    p_max_kw: float = Field(
        ge=MIN_KW, le=MAX_KW, description="largest active power", json_schema_extra=KW
    )
    s_max_kva: float = Field(
        ge=MIN_KW, le=MAX_KW, description="inverter rating", json_schema_extra=KVA
    )
    kind: Name = Field(
        default="pv", description="kind of generator: `pv`, `wind` or another word for the report"
    )
    bus: Name = Field(
        default="", description="bus of a system that stands alone (empty: that of its customer)"
    )


class BatteryRow(Row):
    """A battery; the thermal constants matter only when its temperature is simulated."""

    id: Name = Field(description="identifier of the battery")
    bus: Name = Field(description="bus of the battery")
    energy_kwh: float = Field(
        ge=MIN_KW, le=MAX_KW, description="energy capacity", json_schema_extra=KWH
    )
    p_max_kw: float = Field(
        ge=MIN_KW,
        le=MAX_KW,
        description="largest charging and discharging power",
        json_schema_extra=KW,
    )
    s_max_kva: float = Field(
        ge=MIN_KW, le=MAX_KW, description="inverter rating", json_schema_extra=KVA
    )
    soc_min: float = Field(default=0.15, ge=0, le=1, description="lowest state of charge")
    soc_max: float = Field(default=0.85, ge=0, le=1, description="highest state of charge")
    soc_initial: float | None = Field(
        default=None, ge=0, le=1, description="state of charge at the start (empty: soc_min)"
    )
    eta_charge: float = Field(
        default=0.95, ge=MIN_EFFICIENCY, le=1, description="charging efficiency"
    )
    eta_discharge: float = Field(
        default=0.95, ge=MIN_EFFICIENCY, le=1, description="discharging efficiency"
    )
    r_theta_c_per_kw: float = Field(
        default=3.5,
        ge=MIN_THERMAL,
        le=MAX_THERMAL,
        description="thermal resistance",
        json_schema_extra={"unit": "°C/kW"},
    )
    c_theta_kwh_per_c: float = Field(
        default=0.3,
        ge=MIN_THERMAL,
        le=MAX_THERMAL,
        description="thermal capacitance",
        json_schema_extra={"unit": "kWh/°C"},
    )
    alpha_charge_per_c2: float = Field(
        default=1e-4,
        ge=0,
        le=MAX_LOSS_PER_C2,
        description="loss of charging efficiency per squared deviation from "
        "the reference temperature",
        json_schema_extra=PER_C2,
    )
    alpha_discharge_per_c2: float = Field(
        default=1e-4,
        ge=0,
        le=MAX_LOSS_PER_C2,
        description="loss of discharging efficiency per squared deviation "
        "from the reference temperature",
        json_schema_extra=PER_C2,
    )
    r_int_ohm: float = Field(
        default=0.0035,
        ge=0,
        le=MAX_CELL_OHM,
        description="internal resistance at the reference temperature",
        json_schema_extra=OHM,
    )
    beta_per_c: float = Field(
        default=0.003,
        ge=0,
        le=MAX_LOSS_PER_C2,
        description="temperature coefficient of the internal resistance",
        json_schema_extra={"unit": "1/°C"},
    )
    u_batt_v: float = Field(
        default=900.0,
        ge=1,
        le=MAX_BATTERY_V,
        description="terminal voltage",
        json_schema_extra={"unit": "V"},
    )
    t_ref_c: float = Field(
        default=25.0, ge=-50, le=60, description="reference temperature", json_schema_extra=CELSIUS
    )
    t_initial_c: float | None = Field(
        default=None,
        ge=-50,
        le=100,
        description="temperature at the start (empty: the ambient temperature of the first step)",
        json_schema_extra=CELSIUS,
    )
    grid_forming: Literal["yes", "no"] = Field(
        default="no",
        description="duty of forming the grid of an island in physical mode (where "
        "no battery has it, the one with the largest inverter does)",
    )


class LoadSeries(Row):
    """Demand of the customers; besides `time`, one column per customer identifier."""

    time: str = Field(description="beginning of the step, ISO 8601 with time zone")
    load_kw: float = Field(
        alias="<customer id>",
        ge=0,
        le=MAX_KW,
        description="demand of the customer if served",
        json_schema_extra=KW,
    )


class PVSeries(Row):
    """Available PV power; besides `time`, one column per PV identifier."""

    time: str = Field(description="beginning of the step, ISO 8601 with time zone")
    pv_kw: float = Field(
        alias="<PV id>",
        ge=0,
        le=MAX_KW,
        description="power available from the PV system",
        json_schema_extra=KW,
    )


class SystemSeries(Row):
    """What holds for the whole feeder at each step."""

    time: str = Field(description="beginning of the step, ISO 8601 with time zone")
    price_gbp_per_kwh: float = Field(
        ge=-MAX_PRICE,
        le=MAX_PRICE,
        description="import price (negative: the feeder is paid)",
        json_schema_extra=GBP_PER_KWH,
    )
    temperature_c: float = Field(
        ge=-50, le=60, description="ambient temperature", json_schema_extra=CELSIUS
    )
    grid_limit_kw: float | None = Field(
        default=None,
        ge=0,
        le=MAX_KW,
        description="largest import from the grid (inf, or no such column: no limit)",
        json_schema_extra=KW,
    )
    export_limit_kw: float | None = Field(
        default=None,
        ge=0,
        le=MAX_KW,
        description="largest export to the grid (inf: no limit; no such column: what scenario.toml "
        "says); 0 in an outage, whatever it says",
        json_schema_extra=KW,
    )
    export_price_gbp_per_kwh: float = Field(
        default=0.0,
        ge=-MAX_PRICE,
        le=MAX_PRICE,
        description="what exported energy earns (negative: the feeder pays)",
        json_schema_extra=GBP_PER_KWH,
    )


class OutageRow(Row):
    """An outage that was, over the half-open interval from `start` to `end`."""

    start: str = Field(description="beginning of the outage, ISO 8601 with time zone")
    end: str = Field(description="end of the outage, ISO 8601 with time zone")


class WarningRow(Row):
    """A message about an outage; of each outage the last one that was issued counts."""

    issued_at: str = Field(description="time of issue, ISO 8601 with time zone")
    outage: Name = Field(
        default="", description="which outage it speaks of, where several are expected"
    )
    preset: Literal[WARNING_PRESETS] = Field(  # type: ignore[valid-type]
        default="", description="kind of warning that fills in what is left empty"
    )
    onset_earliest: str = Field(default="", description="earliest beginning of the outage")
    onset_likely: str = Field(default="", description="most likely beginning of the outage")
    onset_latest: str = Field(default="", description="latest beginning of the outage")
    probability: float | None = Field(
        default=None,
        ge=0,
        le=1,
        description="probability of the outage on this feeder (0: the all-clear; empty: 1, or the "
        "preset's)",
    )
    duration_p10_h: float | None = Field(
        default=None,
        gt=0,
        le=MAX_OUTAGE_H,
        description="length of the whole outage that it stays below with a probability of 10 %",
        json_schema_extra=HOURS,
    )
    duration_p50_h: float | None = Field(
        default=None,
        gt=0,
        le=MAX_OUTAGE_H,
        description="median length of the whole outage (empty: the preset's or the statistics')",
        json_schema_extra=HOURS,
    )
    duration_p90_h: float | None = Field(
        default=None,
        gt=0,
        le=MAX_OUTAGE_H,
        description="length of the whole outage that it stays below with a probability of 90 %",
        json_schema_extra=HOURS,
    )


class Section(BaseModel):
    """A section of scenario.toml; TOML has types, so nothing is converted."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True)


class TimeSection(Section):
    """The time grid."""

    start: AwareDatetime = Field(description="beginning of the first step, with time zone")
    step_minutes: float = Field(
        ge=1, le=1440, description="length of a step", json_schema_extra={"unit": "min"}
    )
    steps: int = Field(ge=1, le=MAX_STEPS, description="number of steps")
    zone: Annotated[Name, AfterValidator(_known_zone)] = Field(
        default=UTC, description="time zone of the clocks on the feeder, for the report"
    )


class NetworkSection(Section):
    """The grid connection and the voltage limits."""

    base_kv: float = Field(
        ge=MIN_KV,
        le=MAX_KV,
        description="nominal line-to-line voltage",
        json_schema_extra={"unit": "kV"},
    )
    # Buses may be numbers or names: both are compared as text until lines.csv has been read.
    slack_bus: Name = Field(
        min_length=1,
        strict=False,
        coerce_numbers_to_str=True,
        description="bus of the grid connection",
        json_schema_extra={"type": ["string", "integer"]},
    )
    v_slack_pu: float = Field(
        default=Network.v_slack_pu,
        ge=MIN_PU,
        le=2,
        description="voltage of the slack bus",
        json_schema_extra=PU,
    )
    v_min_pu: float = Field(
        default=Network.v_min_pu,
        ge=MIN_PU,
        le=2,
        description="lowest voltage in the optimisation",
        json_schema_extra=PU,
    )
    v_max_pu: float = Field(
        default=Network.v_max_pu,
        ge=MIN_PU,
        le=2,
        description="highest voltage in the optimisation",
        json_schema_extra=PU,
    )
    v_min_ac_pu: float = Field(
        default=Network.v_min_ac_pu,
        ge=MIN_PU,
        le=2,
        description="lowest voltage allowed in the AC power flow",
        json_schema_extra=PU,
    )
    v_max_ac_pu: float = Field(
        default=Network.v_max_ac_pu,
        ge=MIN_PU,
        le=2,
        description="highest voltage allowed in the AC power flow",
        json_schema_extra=PU,
    )
    export_limit_kw: float | None = Field(
        default=None,
        ge=0,
        le=MAX_KW,
        description="largest export to the grid in all steps; 0 imports only (no such key: what "
        "system.csv says, or no limit)",
        json_schema_extra=KW,
    )


class ObjectiveSection(Section):
    """The weights of the objective, for powers in kW."""

    lambda_grid: float = Field(
        default=ObjectiveWeights.lambda_grid,
        ge=0,
        le=MAX_LAMBDA,
        description="weight of the import cost",
        json_schema_extra={"unit": "1/GBP"},
    )
    lambda_curt: float = Field(
        default=ObjectiveWeights.lambda_curt,
        ge=0,
        le=MAX_LAMBDA,
        description="weight of curtailed PV power",
        json_schema_extra={"unit": "1/kW"},
    )
    lambda_l: float = Field(
        default=ObjectiveWeights.lambda_l,
        ge=0,
        le=MAX_LAMBDA,
        description="weight of squared line flows times resistance",
        json_schema_extra={"unit": "1/(ohm kVA²)"},
    )
    lambda_q: float = Field(
        default=ObjectiveWeights.lambda_q,
        ge=0,
        le=MAX_LAMBDA,
        description="weight of the squared use of inverters for reactive power",
    )


class OutageSection(Section):
    """An outage over the half-open interval from `start` to `end`."""

    start: AwareDatetime = Field(description="beginning of the outage, with time zone")
    end: AwareDatetime = Field(description="end of the outage, with time zone")


def _option_section(title: str, section: str, words: str) -> type[Section]:
    """The model of a section whose keys are options of a run, made from their table."""
    fields: dict[str, Any] = {
        key: (_option_type(option), _option_field(option))
        for key, option in section_options(section).items()
    }
    return create_model(title, __base__=Section, __doc__=words, __module__=__name__, **fields)


def _option_type(option: Option) -> Any:
    """Type of an option's key; a default of None says that the key may be absent."""
    kind: Any = Literal[option.choices] if option.choices else option.kind
    return kind if option.default is not None else kind | None


def _option_field(option: Option) -> Any:
    """Default, bounds, unit and meaning of an option's key."""
    absent = f" (no such key: {option.unset})" if option.unset else ""
    bounds: dict[str, Any] = {}
    if option.range is not None:
        bounds["gt" if option.range.open_least else "ge"] = option.range.least
        bounds["lt" if option.range.open_most else "le"] = min(option.range.most, option.file_most)
    bounds = {name: bound for name, bound in bounds.items() if bound < inf}
    return Field(
        default=option.default,
        description=option.meaning + absent,
        json_schema_extra={"unit": option.unit} if option.unit else None,
        **bounds,
    )


# A type checker sees the sections that the table of options makes as sections without keys.
if TYPE_CHECKING:
    ControllerSection = Section
    SwitchingSection = Section
else:
    ControllerSection = _option_section(
        "ControllerSection", "controller", "What a run uses when its options do not say otherwise."
    )
    SwitchingSection = _option_section(
        "SwitchingSection",
        "switching",
        "Rules on switching customers; a run without options of its own uses them.",
    )


class ReliabilitySection(Section):
    """What the report counts lost supply as; it changes no decision."""

    voll_gbp_per_kwh: float = Field(
        default=DEFAULT_VOLL_GBP_PER_KWH,
        ge=0,
        le=MAX_PRICE,
        description="value of lost load",
        json_schema_extra=GBP_PER_KWH,
    )


class OutageStatisticsSection(Section):
    """Outages that nobody announces, for runs that do not know them; None is the preset's."""

    preset: Literal[STATISTICS_PRESETS] = Field(  # type: ignore[valid-type]
        default="average", description="public figures to begin with"
    )
    saifi_per_year: float | None = Field(
        default=None,
        ge=0,
        le=MAX_SAIFI,
        description="outages of a customer in a year (no such key: the preset's)",
        json_schema_extra={"unit": "1/a"},
    )
    caidi_h: float | None = Field(
        default=None,
        gt=0,
        le=MAX_OUTAGE_H,
        description="mean length of an outage (no such key: the preset's)",
        json_schema_extra=HOURS,
    )
    duration_sigma: float | None = Field(
        default=None,
        ge=0,
        le=MAX_SIGMA,
        description="standard deviation of the logarithm of the length (no such key: the preset's)",
    )
    value_of_lost_load_gbp_per_kwh: float | None = Field(
        default=None,
        gt=0,
        le=MAX_PRICE,
        description=f"value of lost load that decides (no such key: {DEFAULT_VOLL_GBP_PER_KWH:g})",
        json_schema_extra=GBP_PER_KWH,
    )


class DeviationSection(Section):
    """Largest difference of a bus voltage from the AC power flow of the source."""

    no_load_pu: float | None = Field(
        default=None,
        ge=0,
        description="without loads and generators (no such key: not known)",
        json_schema_extra=PU,
    )
    as_given_pu: float | None = Field(
        default=None,
        ge=0,
        description="with the loads and generators that the source gives (no such key: not known)",
        json_schema_extra=PU,
    )
    worst_hour_pu: float | None = Field(
        default=None,
        ge=0,
        description="in the hour of the series in which the voltages differ most (no such key: not "
        "known)",
        json_schema_extra=PU,
    )


class SourceSection(Section):
    """Where the feeder comes from; it changes no result."""

    name: SourceName = Field(default="", description="name of the network or its file")
    kind: SourceName = Field(default="", description="which tool's it is")
    notes: list[Note] = Field(
        default=[],
        max_length=MAX_NOTES,
        description="what was simplified, left out or drawn, one sentence each",
    )
    deviation: DeviationSection = Field(
        default=DeviationSection(), description="table [source.deviation]"
    )


class FilesSection(Section):
    """File names inside the folder; the suffix chooses CSV or Parquet."""

    lines: Name = Field(default="lines.csv", pattern=_FILE_NAME, description="file of the lines")
    buses: Name = Field(
        default="buses.csv", pattern=_FILE_NAME, description="file of what buses draw by themselves"
    )
    customers: Name = Field(
        default="customers.csv", pattern=_FILE_NAME, description="file of the customers"
    )
    pv: str = Field(default="pv.csv", pattern=_FILE_NAME, description="file of the PV systems")
    batteries: Name = Field(
        default="batteries.csv", pattern=_FILE_NAME, description="file of the batteries"
    )
    load_kw: Name = Field(
        default="load_kw.csv", pattern=_FILE_NAME, description="file of the load series"
    )
    pv_kw: Name = Field(
        default="pv_kw.csv", pattern=_FILE_NAME, description="file of the PV series"
    )
    system: Name = Field(
        default="system.csv", pattern=_FILE_NAME, description="file of the feeder's series"
    )
    warnings: Name = Field(
        default="warnings.csv", pattern=_FILE_NAME, description="file of the outage warnings"
    )
    history_load_kw: Name = Field(
        default="history_load_kw.csv",
        pattern=_FILE_NAME,
        description="file of the demand before the first step, like that of the load series; steps "
        "may be missing and cells empty (no such file: not known)",
    )
    history_pv_kw: Name = Field(
        default="history_pv_kw.csv",
        pattern=_FILE_NAME,
        description="file of the PV power before the first step, likewise",
    )


class ScenarioFile(Section):
    """The whole of scenario.toml."""

    name: str = Field(
        max_length=MAX_NAME_LENGTH,
        pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$",
        description="short name of the scenario: letters, digits, '-', '_' and '.'",
    )
    title: Title = Field(default="", description="title for headings (empty: the name)")
    time: TimeSection = Field(description="table [time]")
    network: NetworkSection = Field(description="table [network]")
    tiers: dict[Name, Annotated[float, Field(ge=MIN_WEIGHT, le=MAX_WEIGHT)]] = Field(
        min_length=1, description="table [tiers]: weight of each tier, most important first"
    )
    objective: ObjectiveSection = Field(default=ObjectiveSection(), description="table [objective]")
    outages: list[OutageSection] = Field(default=[], description="list of tables [[outages]]")
    controller: ControllerSection = Field(
        default=ControllerSection(), description="table [controller]"
    )
    switching: SwitchingSection = Field(default=SwitchingSection(), description="table [switching]")
    reliability: ReliabilitySection = Field(
        default=ReliabilitySection(), description="table [reliability]"
    )
    outage_statistics: OutageStatisticsSection = Field(
        default=OutageStatisticsSection(), description="table [outage_statistics]"
    )
    source: SourceSection = Field(default=SourceSection(), description="table [source]")
    files: FilesSection = Field(default=FilesSection(), description="table [files]")


TABLES: dict[str, type[BaseModel]] = {
    "scenario.toml": ScenarioFile,
    "scenario.toml, [time]": TimeSection,
    "scenario.toml, [network]": NetworkSection,
    "scenario.toml, [objective]": ObjectiveSection,
    "scenario.toml, [[outages]]": OutageSection,
    "scenario.toml, [controller]": ControllerSection,
    "scenario.toml, [switching]": SwitchingSection,
    "scenario.toml, [reliability]": ReliabilitySection,
    "scenario.toml, [outage_statistics]": OutageStatisticsSection,
    "scenario.toml, [source]": SourceSection,
    "scenario.toml, [source.deviation]": DeviationSection,
    "scenario.toml, [files]": FilesSection,
    "lines.csv": LineRow,
    "buses.csv": BusRow,
    "customers.csv": CustomerRow,
    "pv.csv": PVRow,
    "batteries.csv": BatteryRow,
    "load_kw.csv": LoadSeries,
    "pv_kw.csv": PVSeries,
    "system.csv": SystemSeries,
    "warnings.csv": WarningRow,
}


def unit(field: FieldInfo) -> str:
    """Unit of a field, empty if it has none.

    >>> unit(PVRow.model_fields["p_max_kw"])
    'kW'
    """
    extra = field.json_schema_extra
    return str(extra.get("unit", "")) if isinstance(extra, dict) else ""


def limits(field: FieldInfo) -> tuple[float, float]:
    """Inclusive lower and upper bound of a field, infinite where it has none.

    >>> limits(SystemSeries.model_fields["temperature_c"])
    (-50.0, 60.0)
    """
    lower = [float(str(m.ge)) for m in field.metadata if isinstance(m, Ge)]
    upper = [float(str(m.le)) for m in field.metadata if isinstance(m, Le)]
    return max(lower, default=float("-inf")), min(upper, default=float("inf"))


def cure(field: FieldInfo) -> str:
    """What to write into a field.

    >>> cure(PVRow.model_fields["p_max_kw"])
    'Give the largest active power in kW.'
    """
    return f"Give the {field.description}{f' in {unit(field)}' if unit(field) else ''}."
