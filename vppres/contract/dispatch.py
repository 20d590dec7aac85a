"""A dispatch as plain arrays: the common language of models, controllers and plant."""

from __future__ import annotations

from dataclasses import dataclass, fields

from vppres.core.arrays import Flags, Floats


@dataclass(frozen=True, eq=False)
class Dispatch:
    """A dispatch of W steps as plain arrays, after the paper's Table "Optimization Variables".

    ``soc`` has one row more than the steps: row 0 is the state at the beginning of the window. The
    dispatch of a form without network has NaN in place of reactive power, flows and voltages. The
    grid's power is negative where it is exported. ``v_node_pu`` are voltages by phase, in plans of
    phased feeders. ``share`` is the part of its demand that each customer gets, 0 where it is off;
    None if all get it whole that are served. ``ev_kw`` is the power of each charger of vehicles,
    negative to discharge; None if no vehicle is plugged in. ``thermal_kw`` is the power of each
    machine that cools or heats; None if there is none. ``genset_on`` says which generating
    sets run, ``genset_kw`` what each gives; None if there is none.
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
    ev_kw: Floats | None = None
    thermal_kw: Floats | None = None
    genset_on: Flags | None = None
    genset_kw: Floats | None = None

    @property
    def n_steps(self) -> int:
        """Number of steps W."""
        return len(self.p_grid_kw)

    @property
    def supplied(self) -> Flags | Floats:
        """Part of the demand that each customer gets, (W, C)."""
        return self.served if self.share is None else self.share

    def arrays(self) -> dict[str, Flags | Floats]:
        """The arrays that it has, by their names."""
        named = {f.name: getattr(self, f.name) for f in fields(self)}
        return {name: values for name, values in named.items() if values is not None}
