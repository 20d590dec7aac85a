"""Relief of an island's former, one of whose phases is beyond its part of the rating."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from vppres.core.arrays import Flags, Floats
from vppres.physics.feeder import PowerFlow
from vppres.physics.powerflow import ACResult
from vppres.plant.changes import CUT_MARGIN_KW, TAKE_LESS, forms, part_of, taking_less
from vppres.plant.formers import Former
from vppres.plant.plant import Plant, Powers

LITTLE_KW = 1e-3
"""Power on a phase that is not worth a change."""


@dataclass(frozen=True, eq=False)
class OnPhases:
    """Phases on which devices are, (phases, n) each; all are on the one of a balanced feeder.

    ``units`` are those of each kind. A device's power is that of all its phases, in equal parts.
    """

    plant: Plant
    customers: Flags
    pv: Flags
    batteries: Flags
    units: Mapping[str, Flags]

    @classmethod
    def of(cls, plant: Plant, flow: PowerFlow) -> OnPhases:
        """Phases of a plant's devices."""
        at = plant.places
        units = {kind: flow.on_phase(places) for kind, places in at.units.items()}
        customers, pv, batteries = map(flow.on_phase, (at.customers, at.pv, at.batteries))
        return cls(plant, customers, pv, batteries, units)

    @property
    def n_phases(self) -> int:
        """Phases of the former."""
        return len(self.customers)

    def room_kw(self, room_kw: Floats, ac: ACResult) -> Floats:
        """Further discharge of batteries that turns no phase of the former round, (B,).

        It is at most what the former gives on a phase, and in all. A former with one phase takes
        what it is given.
        """
        if self.n_phases == 1:
            return room_kw
        each_kw = _by_phase_kw(room_kw, self.batteries)
        former_kw = ac.source_kva.real
        given_kw = np.maximum(former_kw, 0.0)
        share = np.divide(
            given_kw, each_kw.sum(axis=1), where=each_kw.any(axis=1), out=np.ones(self.n_phases)
        )
        least = np.where(each_kw > 0.0, np.minimum(share, 1.0)[:, None], 1.0).min(axis=0)
        return np.asarray(part_of(room_kw * least, max(float(former_kw.sum()), 0.0)))

    def relieved(
        self,
        t: int,
        powers: Powers,
        ac: ACResult,
        need_kw: float,
        room_kw: Floats,
        former: Former,
    ) -> Powers | None:
        """Powers with less on the fullest phase, all customers on; None if there are none.

        ``need_kw`` is what the former's phases lack, if all lacked what the fullest does;
        ``room_kw`` the further discharge of batteries, (B,).
        """
        fullest = ac.fullest
        if ac.source_kva[fullest].real < 0.0:
            return self._without(powers, former, fullest)
        need_kw = (need_kw - CUT_MARGIN_KW) / self.n_phases + CUT_MARGIN_KW
        for kind in TAKE_LESS:
            taken_kw = np.maximum(powers.taken_kw.get(kind, np.zeros(0)), 0.0)
            if taken_kw.any():
                there_kw = _by_phase_kw(taken_kw, self.units[kind])[fullest]
                if there_kw.sum() > LITTLE_KW:
                    off_kw = _on_phase(taken_kw, there_kw, need_kw)
                    less = taking_less(self.plant, t, powers, kind, off_kw)
                    if less is not None:
                        return less
        there_kw = _by_phase_kw(room_kw, self.batteries)[fullest]
        if there_kw.sum() > LITTLE_KW:
            given_kw = _on_phase(room_kw, there_kw, need_kw)
            return replace(powers, battery_kw=powers.battery_kw - given_kw)
        return None

    def without_any(self, powers: Powers, former: Former) -> Powers | None:
        """Powers with nothing but the former giving; None if nothing gave."""
        return self._without(powers, former, slice(None))

    def _without(self, powers: Powers, former: Former, phases: int | slice) -> Powers | None:
        """Powers without what others give on some phases; None if no device gives there."""
        pv, batteries = (
            np.atleast_2d(flags[phases]).any(axis=0) for flags in (self.pv, self.batteries)
        )
        batteries &= ~former.batteries
        export = np.where(pv, powers.pv_export_kw, 0.0)
        feeding = np.where(batteries, np.minimum(powers.battery_kw, 0.0), 0.0)
        stops = {
            kind: np.atleast_2d(flags[phases]).any(axis=0)
            & ~forms(powers, kind)
            & (powers.taken_kw[kind] < 0.0)
            for kind, flags in self.units.items()
        }
        if not (export.any() or feeding.any() or any(each.any() for each in stops.values())):
            return None
        return replace(
            powers,
            pv_export_kw=powers.pv_export_kw - export,
            pv_curtailed_kw=powers.pv_curtailed_kw + export,
            pv_q_kvar=np.where(pv, 0.0, powers.pv_q_kvar),
            battery_kw=powers.battery_kw - feeding,
            batt_q_kvar=np.where(batteries, 0.0, powers.batt_q_kvar),
            taken_kw={k: np.where(stops[k], 0.0, kw) for k, kw in powers.taken_kw.items()},
            running={k: on & ~stops[k] for k, on in powers.running.items()},
        )


def _by_phase_kw(power_kw: Floats, on: Flags) -> Floats:
    """Powers of devices on each phase, (phases, n)."""
    return np.asarray(on * power_kw / np.maximum(on.sum(axis=0), 1))


def _on_phase(power_kw: Floats, there_kw: Floats, need_kw: float) -> Floats:
    """So much of the powers of devices with power on a phase that it meets a need there, (n,)."""
    return power_kw * (there_kw > 0.0) * min(1.0, need_kw / float(there_kw.sum()))
