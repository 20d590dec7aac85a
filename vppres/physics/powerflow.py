"""AC power flow of what the plant did.

The check shares the network's data with the optimiser, never its equations: the full AC equations
are solved by Newton's method (:mod:`vppres.physics.newton`). What it does not find is followed from
no load up (:mod:`vppres.physics.nose`): to the answer, or to the load beyond which there is none.
pandapower is the judge of both: in the tests, where a network is imported, and on request
(:mod:`vppres.feeders.cross_check`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from vppres.core.arrays import Complexes, Flags, Floats, Wholes, freeze_arrays
from vppres.core.errors import InputError, VerificationError
from vppres.core.units import kw_to_mw, mw_to_kw
from vppres.physics.admittances import Admittances, admittances_of
from vppres.physics.newton import Newton
from vppres.physics.nose import Followed, follow
from vppres.scenario.network import Network

TOLERANCE_MVA = 1e-9
"""Largest mismatch of power at any bus, 1 mW."""

ROUNDING = 4.0
"""Rounding errors of the mismatch in units of ``eps |Y| V²``; see :func:`reachable_mva`. On
random loads of a feeder with a line of 1e-4 to 1e-8 ohm Newton's method comes to rest below one of
them; four also cover buses with many lines and voltages above 1 pu."""

LARGEST_TOLERANCE_MVA = 1e-6
"""1 W: where rounding allows no less, Newton's method in voltages is no judge, and its answer
would be noise in what islands settle with."""


class NoSolutionError(VerificationError):
    """The power flow has no solution: from no load up, voltages collapse before these injections.

    Parameters
    ----------
    message : str
        Net load, where it is largest, and the share of it that has a solution.
    share : float
        That share.
    """

    def __init__(self, message: str, share: float) -> None:
        super().__init__(message)
        self.share = share


class NotFoundError(VerificationError):
    """No solution was found, and nothing shows that there is none.

    Parameters
    ----------
    message : str
        Net load, where it is largest, and by what the best answer misses it.
    best : ACResult
        The answer with the smallest mismatch; it has not converged.
    """

    def __init__(self, message: str, best: ACResult) -> None:
        super().__init__(message)
        self.best = best


@dataclass(frozen=True, eq=False)
class ACResult:
    """One AC power flow; the arrays are read-only."""

    v_pu: Floats  #: voltage magnitude, in the network's bus order, (N,)
    #: Flow at the sending end of each line, positive away from the network's slack bus, (L,). The
    #: line's own charging is not in it: it stands at the buses.
    p_from_kw: Floats
    q_from_kvar: Floats
    #: Flow that arrives at the receiving end, positive away from the network's slack bus, (L,).
    p_to_kw: Floats
    q_to_kvar: Floats
    losses_kw: float  #: active losses of all lines, and what leakage and shunts draw
    #: What the source at the reference place gives: the import, unless an island was solved.
    p_slack_kw: float
    q_slack_kvar: float
    #: Voltages that have limits, (m,): of nodes or between them, of the buses where these are the
    #: nodes.
    v_node_pu: Floats
    #: What the reference place gives on each phase, source and devices, (3,) or (1,); in all if
    #: balanced.
    source_kva: Complexes
    #: Bus and phase, or pair of phases, of each of them; empty on a balanced feeder.
    nodes: tuple[tuple[str, str], ...] = ()
    phases: str = ""  #: the source's phases; empty on a balanced feeder
    #: Largest unbalance factor of any bus with three phases; NaN on a balanced feeder.
    unbalance: float = np.nan
    #: Largest current of a phase as a share of the rating of its line or transformer, and where;
    #: NaN on a balanced feeder.
    loading: float = np.nan
    loading_at: str = ""
    #: Always true in what :meth:`ACPowerFlow.solve` returns: without convergence it raises. False
    #: in ``NotFoundError.best``.
    converged: bool = True

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def fullest(self) -> int:
        """The phase on which the source gives or takes most."""
        return int(np.abs(self.source_kva).argmax())

    @property
    def fullest_kva(self) -> float:
        """Power of a source whose phases all give what the fullest of its own does."""
        return float(len(self.source_kva) * np.abs(self.source_kva).max())


class ACPowerFlow:
    """AC power flow of a balanced feeder, whose buses are its nodes and its places.

    It is built once and solved for one injection after another.

    A solve tries, one after another until one converges: Newton's method from the voltages of the
    solve before; from a flat start; the same with the tolerance that rounding allows, where that is
    larger; and the curve from no load up in voltages and currents, which has no such limit.

    Parameters
    ----------
    network : Network
        The reference bus is held at ``v_slack_pu``. What the network itself draws (shunts,
        charging, fixed demand) is part of every flow.

    Examples
    --------
    >>> flow = ACPowerFlow(Network([1], [2], [1.0], [1.0], slack_bus=1, base_kv=10.0))
    >>> result = flow.solve([0.0, -100.0], [0.0, 0.0])
    >>> round(float(result.v_pu[1]), 5), round(result.losses_kw, 4)
    (0.999, 0.1002)
    """

    def __init__(self, network: Network) -> None:
        self.network = network
        self.tolerance_mva = reachable_mva(network)
        self._admittances = admittances_of(network)
        self._newtons: dict[int, Newton] = {}
        self._last: dict[int, Complexes] = {}

    def solve(self, p_kw: ArrayLike, q_kvar: ArrayLike, reference: int = 0) -> ACResult:
        """Power flow for the net injection of every bus.

        That is of all devices, generation positive; at the reference bus it lowers what the source
        gives. ``reference`` is the position of the bus with the only source, 0 for the grid. With
        another bus the network is an island: nothing can come from the grid's bus.

        Raises
        ------
        InputError
            If the shape is wrong or a value is not finite.
        NoSolutionError
            If the curve from no load turns back before these injections; a VerificationError.
        NotFoundError
            If there is no convergence and no such evidence; a VerificationError. Both messages
            have the net load, the step is the caller's.
        """
        p = self._checked("p_kw", p_kw)
        q = self._checked("q_kvar", q_kvar)
        net = self.network
        s_mva = _summed(kw_to_mw(p - net.p_fixed_kw)) + 1j * _summed(kw_to_mw(q - net.q_fixed_kvar))
        if reference not in self._newtons:
            v_source = float(net.held_pu[reference] / net.bus_ratio[reference])
            self._newtons[reference] = Newton(self._admittances.bus, reference, v_source)
        v = self._by_newton(reference, s_mva)
        if v is None:
            return self._followed(p, q, reference)
        self._last[reference] = v
        return _read(net, self._admittances, v, s_mva, reference)

    def dead(self) -> ACResult:
        """The result without any source: NaN, and no flow."""
        none, v_pu = np.zeros(self.network.n_lines), np.full(self.network.n_buses, np.nan)
        source = np.full(1, np.nan, dtype=complex)
        return ACResult(v_pu, none, none, none, none, 0.0, 0.0, 0.0, v_pu, source)

    def on_phase(self, places: Wholes) -> Flags:
        """Every device is on all that there is, (1, n)."""
        return np.ones((1, len(places)), dtype=bool)

    def _by_newton(self, reference: int, s_mva: Complexes) -> Complexes | None:
        """Voltages from those of the solve before, else from a flat start; None if not found."""
        newton = self._newtons[reference]
        flat = newton.flat()
        attempts = [(flat, TOLERANCE_MVA)]
        last = self._last.pop(reference, None)
        if last is not None:
            attempts.insert(0, (newton.again(last), TOLERANCE_MVA))
        if TOLERANCE_MVA < self.tolerance_mva <= LARGEST_TOLERANCE_MVA:
            attempts.append((flat, self.tolerance_mva))
        found = (newton.solve(start, s_mva, tolerance) for start, tolerance in attempts)
        return next((v for v in found if v is not None), None)

    @property
    def tolerance_kva(self) -> float:
        """Power that a solved flow may miss at a bus; the source's power is no better known."""
        return float(mw_to_kw(min(self.tolerance_mva, LARGEST_TOLERANCE_MVA)))

    def _followed(self, p_kw: Floats, q_kvar: Floats, reference: int) -> ACResult:
        """The end of the curve from no load; where it turns back there is no solution."""
        net = self.network
        net_p_mw = kw_to_mw(p_kw - net.p_fixed_kw)
        net_q_mvar = kw_to_mw(q_kvar - net.q_fixed_kvar)
        found = follow(net, net_p_mw, net_q_mvar, reference)
        if found.outcome == "solved":
            return _read_followed(self.network, found, p_kw, q_kvar, reference)
        if found.outcome == "none":
            raise NoSolutionError(
                f"the AC power flow has no solution: {self._net_load(p_kw, q_kvar)}, and voltages "
                f"collapse at {found.share:.1%} of it. The lines cannot carry it: check the units "
                "of loads and impedances, or serve less.",
                found.share,
            )
        best = _read_followed(self.network, found, p_kw, q_kvar, reference)
        worst = int(np.argmax(found.mismatch_mva))
        missed_kva = float(mw_to_kw(found.mismatch_mva[worst]))
        raise NotFoundError(
            f"the AC power flow was not found: {self._net_load(p_kw, q_kvar)}; the best answer "
            f"misses {missed_kva:.3g} kVA at bus {self.network.buses[worst]}. Nothing shows that "
            "there is no solution: check the impedances of the lines.",
            best,
        )

    def restart(self) -> None:
        """Forget the last solution: the next solve starts flat."""
        self._last.clear()

    @property
    def found(self) -> dict[int, Complexes]:
        """Voltages of the last solutions by their reference, from which the next solves start."""
        return dict(self._last)

    def go_on_from(self, found: Mapping[int, Complexes]) -> None:
        """Start the next solves from solutions that were found before, here or elsewhere."""
        self._last = dict(found)

    def _checked(self, name: str, values: ArrayLike) -> Floats:
        """Injections as an array with one finite value per bus."""
        array = np.asarray(values, dtype=float)
        if array.shape != (self.network.n_buses,):
            raise InputError.of(
                "power flow",
                "has the wrong shape",
                f"Give one injection for each of the {self.network.n_buses} buses.",
                field=name,
                value=array.shape,
            )
        wrong = np.flatnonzero(~np.isfinite(array))
        if len(wrong):
            raise InputError.of(
                "power flow",
                "is not a finite number",
                f"Correct the load, PV or battery power at bus {self.network.buses[wrong[0]]}.",
                field=name,
                value=array[wrong[0]],
            )
        return array

    def _net_load(self, p_kw: Floats, q_kvar: Floats) -> str:
        """The load in words."""
        worst = int(np.argmin(p_kw))
        return (
            f"net load {-p_kw.sum():.1f} kW and {0.0 - q_kvar.sum():.1f} kvar, the largest "
            f"{-p_kw[worst]:.1f} kW at bus {self.network.buses[worst]}"
        )


def reachable_mva(network: Network) -> float:
    """Smallest mismatch of power that Newton's method can be asked for, 1 mW or more.

    Examples
    --------
    Of a line of 1e-5 ohm at 12.47 kV 1 mW cannot be asked:

    >>> reachable_mva(Network([1], [2], [1.0], [1.0], slack_bus=1, base_kv=12.47))
    1e-09
    >>> reachable_mva(Network([1], [2], [1e-5], [1e-5], slack_bus=1, base_kv=12.47)) > 1e-8
    True
    """
    # The power of bus i is V_i conj(sum_k Y_ik V_k). Its terms are of the size |Y_ik| V², cancel
    # to the little that flows, and leave their rounding: |error| <= c eps sum_k |Y_ik| V² with a
    # small c (Higham, Accuracy and Stability of Numerical Algorithms, 2nd ed., section 3.1, inner
    # products). The diagonal is the sum of the others, hence the factor 2. With the base voltage in
    # kV and ohm, |Y| V² is in MVA.
    z_ohm = np.hypot(network.referred_r_ohm, network.referred_x_ohm)
    at_line = network.base_kv**2 / z_ohm
    sums = abs(network.incidence) @ at_line
    return max(TOLERANCE_MVA, float(ROUNDING * np.finfo(float).eps * 2.0 * sums.max()))


def _summed(powers: Floats) -> Floats:
    """The powers of all buses as pandapower adds them up: differences of running sums.

    It costs a rounding of the total, far below any tolerance; answers are equal to the last bit.
    """
    return np.diff(np.cumsum(powers), prepend=0.0)


def _in_kva(s_mva: complex) -> Complexes:
    """A source's power on its only phase, (1,)."""
    return np.array([complex(mw_to_kw(s_mva.real), mw_to_kw(s_mva.imag))])


def _read(
    network: Network, admittances: Admittances, v: Complexes, s_mva: Complexes, reference: int
) -> ACResult:
    """Results of voltages in the network's order and in kW."""
    y = admittances
    sent = v[y.from_bus] * np.conj(y.sending @ v)
    # Both ends count as flowing into the line.
    arrived = v[y.to_bus] * np.conj(y.receiving @ v)
    source = (v * np.conj(y.bus @ v))[reference]
    own = s_mva[reference]
    v_referred = np.abs(v)
    losses_kw = float(mw_to_kw(sent.real + arrived.real).sum())
    v_pu = v_referred * network.bus_ratio
    return ACResult(
        v_pu=v_pu,
        p_from_kw=mw_to_kw(sent.real),
        q_from_kvar=mw_to_kw(sent.imag),
        p_to_kw=-mw_to_kw(arrived.real),
        q_to_kvar=-mw_to_kw(arrived.imag),
        losses_kw=losses_kw + float(network.shunt_kw @ v_referred**2),
        p_slack_kw=float(mw_to_kw(source.real - own.real)),
        q_slack_kvar=float(mw_to_kw(source.imag - own.imag)),
        v_node_pu=v_pu,
        source_kva=_in_kva(source),
    )


def _read_followed(
    network: Network, found: Followed, p_kw: Floats, q_kvar: Floats, reference: int
) -> ACResult:
    """Results of a followed curve in kW."""
    sent = found.v[network.parent] * np.conj(found.i)
    arrived = found.v[1:] * np.conj(found.i)
    v_referred = np.abs(found.v)
    losses_kw = float(mw_to_kw((sent - arrived).real.sum()))
    # What leaves the reference bus over its lines comes from its source and its own injection,
    # less what the network draws there.
    source = -found.v[reference] * np.conj((network.incidence @ found.i)[reference])
    v_pu = v_referred * network.bus_ratio
    own_kw, own_kvar = network.drawn(v_pu)
    return ACResult(
        v_pu=v_pu,
        p_from_kw=mw_to_kw(sent.real),
        q_from_kvar=mw_to_kw(sent.imag),
        p_to_kw=mw_to_kw(arrived.real),
        q_to_kvar=mw_to_kw(arrived.imag),
        losses_kw=losses_kw + float(network.shunt_kw @ v_referred**2),
        p_slack_kw=float(mw_to_kw(source.real) - p_kw[reference] + own_kw[reference]),
        q_slack_kvar=float(mw_to_kw(source.imag) - q_kvar[reference] + own_kvar[reference]),
        v_node_pu=v_pu,
        source_kva=_in_kva(source),
        converged=found.outcome == "solved",
    )
