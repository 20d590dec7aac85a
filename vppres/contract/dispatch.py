"""A dispatch as plain arrays: the common language of models, controllers and plant."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import Any, Self

import numpy as np

from vppres.core.arrays import Flags, Floats
from vppres.kinds.kind import Units


@dataclass(frozen=True, eq=False)
class Dispatch:
    """A dispatch of W steps as plain arrays, after the paper's Table "Optimization Variables".

    ``soc`` has one row more than the steps: row 0 is the state at the beginning of the window. The
    dispatch of a form without network has NaN instead of reactive power, flows and voltages. The
    grid's power is negative where it is exported. ``v_node_pu`` are voltages by phase, in plans of
    phased feeders. ``share`` is the part of its demand that each customer gets, 0 where it is off;
    None if all get it whole that are served. ``taken_kw`` has, by kind of flexible power
    (:mod:`vppres.kinds.table`), what each of its units takes, negative where it gives, and
    ``running`` which are on, of kinds that are started and stopped; ``given_kvar`` has the reactive
    power of those that form the grid. A kind that is not there does nothing.
    """

    served: Flags
    pv_self_kw: Floats
    pv_export_kw: Floats
    pv_curtailed_kw: Floats
    pv_q_kvar: Floats
    charge_kw: Floats
    discharge_kw: Floats
    batt_q_kvar: Floats
    soc: Floats
    p_grid_kw: Floats
    q_grid_kvar: Floats
    v_pu: Floats
    p_flow_kw: Floats
    q_flow_kvar: Floats
    v_node_pu: Floats | None = None
    share: Floats | None = None
    taken_kw: dict[str, Floats] = field(default_factory=dict)
    running: dict[str, Flags] = field(default_factory=dict)
    given_kvar: dict[str, Floats] = field(default_factory=dict)

    @classmethod
    def one_step(cls, **rows: Any) -> Self:
        """A dispatch of one step from its rows; what has its rows already is left as it is."""
        arrays: dict[str, Any] = {
            name: value if name in ("soc", "given_kvar") else np.asarray(value)[np.newaxis]
            for name, value in rows.items()
        }
        return cls(**arrays)

    @property
    def n_steps(self) -> int:
        """Number of steps W."""
        return len(self.p_grid_kw)

    @property
    def supplied(self) -> Flags | Floats:
        """Part of the demand that each customer gets, (W, C)."""
        return self.served if self.share is None else self.share

    def arrays(self) -> dict[str, Flags | Floats]:
        """The arrays that it has, by their names; not those by kind."""
        named = {f.name: getattr(self, f.name) for f in fields(self)}
        return {name: values for name, values in named.items() if isinstance(values, np.ndarray)}

    def taken_by(self, kind: str, units: Units) -> Floats:
        """Power that each unit of a kind takes, (W, n)."""
        found = self.taken_kw.get(kind)
        return np.zeros((self.n_steps, len(units))) if found is None else found

    def running_of(self, kind: str, units: Units) -> Flags:
        """Units of a kind that are on, (W, n)."""
        found = self.running.get(kind)
        shape = (self.n_steps, len(units))
        return np.zeros(shape, dtype=bool) if found is None else found

    def step(self, row: int) -> Self:
        """One of its steps."""
        now = slice(row, row + 1)
        by_kind = {
            name: {kind: values[now] for kind, values in getattr(self, name).items()}
            for name in ("taken_kw", "running", "given_kvar")
        }
        rows: dict[str, Any] = {name: values[now] for name, values in self.arrays().items()}
        return replace(self, **rows | by_kind | {"soc": self.soc[row : row + 2]})

    def acting(self, kind: str, taken_kw: Floats, running: Flags | None = None) -> Self:
        """Dispatch with the powers of a kind, and which of its units are on."""
        more = {} if running is None else {kind: running}
        return replace(
            self, taken_kw={**self.taken_kw, kind: taken_kw}, running={**self.running, **more}
        )
