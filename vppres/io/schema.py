"""The table of attributes: every column and key that a scenario folder may hold.

``attributes.csv`` beside this module, and in the folder of each kind, has one line an attribute:
type, unit, bounds, default and meaning. Defaults, checks, messages, the documentation page and the
JSON Schema all come from it.
"""

from __future__ import annotations

from functools import cache
from math import inf
from operator import attrgetter
from types import SimpleNamespace
from typing import TYPE_CHECKING, Annotated, Any, Literal

import pandas as pd
from annotated_types import Ge, Le
from pydantic import AfterValidator, AwareDatetime, BaseModel, ConfigDict, Field, create_model
from pydantic.fields import FieldInfo
from pydantic_core import PydanticCustomError

from vppres.core.tables import packaged_table
from vppres.core.text import flaw_of_name
from vppres.io.times import time_of
from vppres.kinds.table import SERIES as KIND_SERIES
from vppres.kinds.table import TABLES as KIND_TABLES
from vppres.kinds.table import parts
from vppres.scenario.network import Network
from vppres.scenario.option_table import Option, section_options
from vppres.scenario.outage_warnings import STATISTICS_PRESETS, WARNING_PRESETS
from vppres.scenario.scenario import DEFAULT_VOLL_GBP_PER_KWH, ObjectiveWeights
from vppres.scenario.source import MAX_NOTE_LENGTH, MAX_NOTES, MAX_SOURCE_LENGTH
from vppres.scenario.switches import KINDS as SWITCH_KINDS
from vppres.scenario.timegrid import is_zone

MAX_GRID_DAYS = 366
MAX_STEPS = MAX_GRID_DAYS * 1440  # steps of a minute
MAX_SHED_STEPS = 20
MAX_HOMES = 1_000_000
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
MAX_ESTIMATE = 100.0  # a multiple of what was said
MAX_SHARE = 0.99
MIN_X_PCT = 1e-6  # a regulator that is stated without any has a thousand times as much
MAX_PPM = 1e4  # 1%: then it is a shunt, and has a row of its own
MAX_EXPONENT = 6.0  # lamps and motors stay below 4
MAX_BATTERY_V = 1e5  # strings in service stay below 2 kV


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


def _time(text: str) -> pd.Timestamp:
    """The time that a cell says."""
    time, message, cure = time_of(text)
    if time is None:
        raise PydanticCustomError("flawed_name", "{message}", {"message": message, "cure": cure})
    return time


Time = Annotated[str, AfterValidator(_time)]


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

    if TYPE_CHECKING:  # its fields come from the table of attributes

        def __getattr__(self, name: str) -> Any: ...


class TomlSection(Row):
    """A section of scenario.toml; TOML has types, so nothing is converted."""

    model_config = ConfigDict(strict=True)


YES_OR_NO: Any = Literal["yes", "no"]

# What the table calls types; there, [name] is a section and [[name]] a list of them.
_TYPES: dict[str, Any] = {
    "text": str,
    "number": float,
    "whole number": int,
    "date and time": AwareDatetime,
    "time": Time,
    "name": Name,
    "title": Annotated[str, _sound(MAX_TITLE_LENGTH)],
    "source name": Annotated[str, _sound(MAX_SOURCE_LENGTH)],
    "notes": Annotated[list[Annotated[str, _sound(MAX_NOTE_LENGTH)]], Field(max_length=MAX_NOTES)],
    "power factor": Annotated[float, AfterValidator(_active)],
    "zone": Annotated[Name, AfterValidator(_known_zone)],
    "file": Annotated[str, Field(pattern=r"^[^/\\]+\.(csv|parquet)$"), _sound(MAX_NAME_LENGTH)],
    "short name": Annotated[
        str, Field(max_length=MAX_NAME_LENGTH, pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")
    ],
    # Buses may be numbers or names: both are compared as text until lines.csv has been read.
    "bus": Annotated[
        str,
        Field(min_length=1, strict=False, coerce_numbers_to_str=True),
        _sound(MAX_NAME_LENGTH),
    ],
    "tiers": Annotated[
        dict[Name, Annotated[float, Field(ge=MIN_WEIGHT, le=MAX_WEIGHT)]], Field(min_length=1)
    ],
    "yes or no": YES_OR_NO,
    "voltage kind": Literal["ground", "lines"],
    "switch kind": Literal[SWITCH_KINDS],
    "warning preset": Literal[WARNING_PRESETS],
    "statistics preset": Literal[STATISTICS_PRESETS],
}
_JSON_TYPES = {"bus": {"type": ["string", "integer"]}}
# Columns of a series, named by the identifiers of customers, PV systems or units of a kind.
_ALIASES = {("load_kw.csv", "load_kw"): "<customer id>", ("pv_kw.csv", "pv_kw"): "<PV id>"} | {
    (f"{name}.csv", name): f"<{KIND_TABLES[of].key} id>" for name, of in KIND_SERIES.items()
}


# What bounds and defaults of the table may name.
_NAMED = SimpleNamespace(
    Network=Network,
    ObjectiveWeights=ObjectiveWeights,
    DEFAULT_VOLL_GBP_PER_KWH=DEFAULT_VOLL_GBP_PER_KWH,
    **{name: value for name, value in globals().items() if name.startswith(("MIN_", "MAX_"))},
)
_PLACES = (__file__, *(str(part.__file__) for part in parts().values()))
_ATTRIBUTES = [line for place in _PLACES for line in packaged_table(place, "attributes.csv")]
_MODELS = {line["table"]: line for line in packaged_table(__file__, "attribute_tables.csv")} | {
    f"{table.key}.csv": {"model": table.model, "meaning": table.about}
    for table in KIND_TABLES.values()
}
_MODELS |= {
    f"{name}.csv": {"model": f"{name.title().replace('_', '')}Series", "meaning": about}
    for table in KIND_TABLES.values()
    for name, about in table.series.items()
}


@cache
def _model(table: str) -> Any:
    """The model of a table of attributes; a section in brackets may be one of options."""
    fields: dict[str, Any] = {
        line["name"]: _field(line, _type(line["type"]))
        for line in _ATTRIBUTES
        if line["table"] == table
    }
    options = section_options(table.strip("[]"))
    fields |= {key: _option_field(option) for key, option in options.items()}
    base = TomlSection if table.startswith(("[", "scenario.toml")) else Row
    about = _MODELS[table]
    return create_model(
        about["model"], __base__=base, __doc__=about["meaning"], __module__=__name__, **fields
    )


def _type(word: str) -> Any:
    """The type that a line of the table names; [name] is a section, [[name]] a list of them."""
    if word in _TYPES:
        return _TYPES[word]
    return list[_model(word)] if word.startswith("[[") else _model(word)  # type: ignore[misc]


def _field(line: dict[str, str], kind: Any) -> tuple[Any, FieldInfo]:
    """Type, bounds, unit and meaning of an attribute."""
    default = _default(line, kind)
    extra: Any = {"unit": line["unit"]} if line["unit"] else _JSON_TYPES.get(line["type"])
    bounds: dict[str, Any] = {}
    if line["least"]:
        bounds["gt" if line["least"][0] == ">" else "ge"] = _number(line["least"].lstrip(">"))
    if line["most"]:
        bounds["le"] = _number(line["most"])
    return kind if default is not None else kind | None, Field(
        default=default,
        alias=_ALIASES.get((line["table"], line["name"])),
        description=line["meaning"],
        json_schema_extra=extra,
        **bounds,
    )


def _default(line: dict[str, str], kind: Any) -> Any:
    """The default of an attribute; an empty cell is None, or an empty text, list or section."""
    word, cell = line["type"], line["default"]
    if cell == "required":
        return ...
    if kind in (float, int, Time):
        return kind(_number(cell)) if cell else None
    if word == "notes" or word.startswith("[["):
        return []
    return kind() if word.startswith("[") else cell


def _number(cell: str) -> float:
    """A bound or default: a number, or the name of one."""
    sign, size = (-1, cell[1:]) if cell.startswith("-") else (1, cell)
    if size.isdigit():
        return sign * int(size)
    number: float = attrgetter(size)(_NAMED) if size[0].isalpha() else float(size)
    return sign * number


def _option_field(option: Option) -> tuple[Any, FieldInfo]:
    """Type and field of an option's key in scenario.toml."""
    kind: Any = Literal[option.choices] if option.choices else option.kind
    absent = f" (no such key: {option.unset})" if option.unset else ""
    bounds: dict[str, Any] = {}
    if option.range is not None:
        bounds["gt" if option.range.open_least else "ge"] = option.range.least
        bounds["lt" if option.range.open_most else "le"] = min(option.range.most, option.file_most)
    bounds = {name: bound for name, bound in bounds.items() if bound < inf}
    return kind if option.default is not None else kind | None, Field(
        default=option.default,
        description=option.meaning + absent,
        json_schema_extra={"unit": option.unit} if option.unit else None,
        **bounds,
    )


TABLES: dict[str, type[Row]] = {
    f"scenario.toml, {table}" if table.startswith("[") else table: _model(table)
    for table in _MODELS
}
"""Model of each table, by the title that the documentation gives it."""


def row_of(key: str) -> type[Row]:
    """Model of a row of the table with this key under ``[files]``."""
    return TABLES[f"{key}.csv"]


ScenarioFile = _model("scenario.toml")
TimeSection = _model("[time]")
NetworkSection = _model("[network]")
ObjectiveSection = _model("[objective]")
ControllerSection = _model("[controller]")
FilesSection = _model("[files]")
LineRow = _model("lines.csv")
BusRow = _model("buses.csv")
SwitchRow = _model("switches.csv")
CustomerRow = _model("customers.csv")
PVRow = _model("pv.csv")
BatteryRow = _model("batteries.csv")
LoadSeries = _model("load_kw.csv")
PVSeries = _model("pv_kw.csv")
SystemSeries = _model("system.csv")
WarningRow = _model("warnings.csv")
OutageRow = _model("outages.csv")
FaultRow = _model("faults.csv")
PhaseBusRow = _model("phase_buses.csv")
PhaseLineRow = _model("phase_lines.csv")
PhaseTransformerRow = _model("phase_transformers.csv")
PhaseShuntRow = _model("phase_shunts.csv")
PhaseConnectionRow = _model("phase_connections.csv")

MOST_ROWS = {"phase_connections.csv": 3 * MAX_ITEMS}  # customers, PV systems and batteries


def most_rows(file: str) -> int:
    """Most rows of a table of items.

    >>> most_rows("customers.csv"), most_rows("phase_connections.csv")
    (10000, 30000)
    """
    return MOST_ROWS.get(file, MAX_ITEMS)


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
    """Advice for a field: the value to give, and its unit.

    >>> cure(PVRow.model_fields["p_max_kw"])
    'Give the largest active power in kW.'
    >>> cure(SwitchRow.model_fields["operable"])
    'Give yes or no: whether it can be moved.'
    """
    meaning = (field.description or "").partition(" (no such key")[0]
    if meaning.startswith("whether"):
        values = "true or false" if field.annotation is bool else "yes or no"
        return f"Give {values}: {meaning}."
    return f"Give the {meaning}{f' in {unit(field)}' if unit(field) else ''}."
