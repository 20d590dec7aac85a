"""The AC power flow of a tree by continuation: its answer, or the load at which it has none.

The unknowns are the buses' voltages and the lines' currents, so no voltage is subtracted from one
beside it: a line of 1e-12 ohm is as exact as any other. From the flow without load, which is linear
in shunts and charging, the solution is followed while all injections grow together. It either
arrives at the full injections or turns back before, at the nose of the curve, where voltages
collapse and the equations have no solution beyond (Ajjarapu and Christy, The continuation power
flow, IEEE Trans. Power Systems 7(1), 1992). Each point is found by Newton's method.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.linalg import splu

from vppres.core.arrays import Floats
from vppres.core.units import kw_to_mw
from vppres.scenario.network import Network

Complex = NDArray[np.complexfloating[Any, Any]]
Outcome = Literal["solved", "none", "not found"]

TOLERANCE_MVA = 1e-9
"""Largest mismatch of power at any bus: that of the first attempt, and within reach here."""

MAX_CORRECTIONS = 8
"""Newton steps for a point; from a good prediction it takes two to four, more means too far."""

FEW_CORRECTIONS = 3
"""A point that took no more than these was easy: the next step may be twice as long."""

MAX_POINTS = 300
"""Points of the curve. Four to thirty are usual; the end of patience is not a proof of anything."""

NOSE_TOLERANCE = 1e-4
"""Accuracy of the nose, as a share of the injections; messages give three digits of it."""

SHORTEST, LONGEST = 1e-7, 2.0
"""Steps along the curve, in pu of voltage and shares of the injections."""


@dataclass(frozen=True, eq=False)
class Followed:
    """Result of following the curve."""

    #: ``solved``: the flow of all injections. ``none``: the curve turned back before. ``not
    #: found``: neither.
    outcome: Outcome
    #: Voltage of every bus in pu, referred to the slack bus, (N,): the solution, else the last
    #: point of the curve.
    v: Complex
    i: Complex  #: current of every line in MVA per pu, positive away from the grid's bus, (L,)
    #: The largest share of the injections that has a solution on the curve, 1 if solved.
    share: float
    mismatch_mva: Floats  #: by what the point misses the full injections, (N,); 0 at the reference


@dataclass(frozen=True, eq=False)
class _Point:
    """A point of the curve, and the direction in which the curve was heading there."""

    x: Floats
    share: float
    along: Floats
    along_share: float


class _Tree:
    """The equations of a network for one injection.

    ``x`` holds real and imaginary parts of the voltages of all buses but the reference, then of
    the currents of all lines.
    """

    def __init__(self, network: Network, s_mva: Complex, reference: int) -> None:
        n = network.n_buses
        self.free = np.delete(np.arange(n), reference)
        self.reference = reference
        self.v_source = float(network.held_pu[reference] / network.bus_ratio[reference])
        self.z = (network.referred_r_ohm + 1j * network.referred_x_ohm) / network.base_kv**2
        self.s = s_mva
        shunts = kw_to_mw(network.shunt_kw) - 1j * kw_to_mw(network.shunt_kvar)
        self.shunt: Complex = shunts[self.free]
        arrives = sp.csr_array(network.incidence)
        self.leaving = -arrives[self.free]
        self.drop = sp.csr_array(arrives[self.free].T)
        self.at_source = np.asarray(arrives[[reference]].toarray()[0]) * self.v_source
        self.leaves = sp.coo_array(self.leaving)
        drops = sp.coo_array(self.drop)
        lines = np.arange(network.n_lines)
        # Blocks of the derivative by their row and column: Ohm's law is linear in all unknowns.
        self.constant = np.concatenate(
            [drops.data, drops.data, self.z.real, -self.z.imag, self.z.imag, self.z.real]
        )
        blocks: list[tuple[int, int, Any]] = [(0, 0, drops.coords), (1, 1, drops.coords)]
        blocks += [
            (row, column, (lines, lines))
            for row, column in ((0, 2), (0, 3), (1, 2), (1, 3), (2, 0), (2, 1), (3, 0), (3, 1))
        ]
        blocks += [
            (row, column, self.leaves.coords) for row, column in ((2, 2), (2, 3), (3, 2), (3, 3))
        ]
        self.places = (
            np.concatenate([at[0] + row * (n - 1) for row, _, at in blocks]),
            np.concatenate([at[1] + column * (n - 1) for _, column, at in blocks]),
        )

    def flat(self) -> Floats:
        """The flow without any injection."""
        v = np.full(len(self.free), self.v_source)
        nothing = np.zeros(len(self.free))
        if not self.shunt.any():
            return np.concatenate([v, nothing, nothing, nothing])
        # Shunts alone: drop @ v + z i = -at_source and leaving @ i + shunt v = 0.
        equations = sp.block_array(
            [[self.drop, sp.diags_array(self.z)], [sp.diags_array(self.shunt), self.leaving]]
        )
        given = np.concatenate([-self.at_source, nothing]).astype(complex)
        voltage, current = np.split(splu(sp.csc_array(equations)).solve(given), 2)
        return np.concatenate([voltage.real, voltage.imag, current.real, current.imag])

    def split(self, x: Floats) -> tuple[Complex, Complex]:
        """Voltages without the reference, and currents."""
        real, imag, i_real, i_imag = np.split(x, 4)
        return real + 1j * imag, i_real + 1j * i_imag

    def residual(self, x: Floats, share: float) -> Floats:
        """Ohm's law of each line in pu, then the balance of power at each bus in MVA."""
        v, i = self.split(x)
        ohm = self.drop @ v + self.at_source + self.z * i
        balance = v * np.conj(self.leaving @ i + self.shunt * v) - share * self.s[self.free]
        return np.concatenate([ohm.real, ohm.imag, balance.real, balance.imag])

    def slope(self, x: Floats) -> sp.csc_array:
        """Derivative of the residual by ``x``."""
        v, i = self.split(x)
        out = self.leaving @ i + self.shunt * v
        # What a shunt's current changes by, times the voltage.
        by_e = v * np.conj(self.shunt)
        by_f = v * np.conj(1j * self.shunt)
        at_bus = self.leaves.coords[0]
        e = v.real[at_bus] * self.leaves.data
        f = v.imag[at_bus] * self.leaves.data
        values = np.concatenate(
            [
                self.constant,
                out.real + by_e.real,
                out.imag + by_f.real,
                -out.imag + by_e.imag,
                out.real + by_f.imag,
                e,
                f,
                f,
                -e,
            ]
        )
        size = 4 * len(self.free)
        return sp.csc_array((values, self.places), shape=(size, size))

    def by_share(self) -> Floats:
        """Derivative of the residual by the share of the injections."""
        nothing = np.zeros(2 * len(self.z))
        return np.concatenate([nothing, -self.s[self.free].real, -self.s[self.free].imag])

    def weights(self) -> Floats:
        """Weights of ``x`` in the length of a step: the mean over the voltages, no currents."""
        n = len(self.free)
        return np.concatenate([np.full(2 * n, 1.0 / n), np.zeros(2 * n)])

    def reached(self, residual: Floats) -> bool:
        """Whether a point is on the curve; Ohm's law is linear, and exact after any step."""
        mismatch = np.split(residual, 4)
        return float(np.hypot(mismatch[2], mismatch[3]).max()) <= TOLERANCE_MVA

    def read(self, outcome: Outcome, point: _Point, share: float) -> Followed:
        """The answer at a point."""
        v_free, i = self.split(point.x)
        v = np.insert(v_free, self.reference, self.v_source + 0j)
        missed = np.split(self.residual(point.x, 1.0), 4)
        mismatch = np.insert(np.hypot(missed[2], missed[3]), self.reference, 0.0)
        return Followed(outcome, v, i, share, mismatch)


def follow(network: Network, p_mw: Floats, q_mvar: Floats, reference: int = 0) -> Followed:
    """Follow the power flow from no load to the given injections.

    Injections are net, with the fixed demand of the buses taken off; ``reference`` is the position
    of the bus that has the source.

    Examples
    --------
    The largest load at the end of a line of ``z`` is ``1 / (2 (r + |z|))`` for ``q = 0``:

    >>> import numpy as np
    >>> pair = Network([1], [2], [0.02], [0.03], slack_bus=1, base_kv=1.0)
    >>> found = follow(pair, np.array([0.0, -10.0]), np.zeros(2))
    >>> found.outcome, round(found.share, 3), round(float(0.05 / (0.02 + np.hypot(0.02, 0.03))), 3)
    ('none', 0.892, 0.892)
    """
    tree = _Tree(network, p_mw + 1j * q_mvar, reference)
    x = tree.flat()
    point = _Point(x, 0.0, np.zeros_like(x), 1.0)
    try:
        with np.errstate(all="ignore"):  # a step too long is judged by its residual
            return _follow(tree, _heading(tree, point))
    except RuntimeError:  # SuperLU: exactly singular, so the curve cannot be told from here
        return tree.read("not found", point, 0.0)


def _follow(tree: _Tree, point: _Point) -> Followed:
    """Point after point until the injections are reached, the curve turns, or nothing helps."""
    length = min(1.0 / max(point.along_share, 1.0 / LONGEST), LONGEST)
    for _ in range(MAX_POINTS):
        rest = (1.0 - point.share) / point.along_share
        last = length >= rest
        step = rest if last else length
        tried = _corrected(tree, point, step, last)
        if tried is None:
            length = step / 2
            if length < SHORTEST:
                break
            continue
        found, corrections = tried
        if last and found.along_share > 0:
            return tree.read("solved", found, 1.0)
        if found.along_share <= 0:
            # Between the two the share is a parabola along the curve; its top is the nose.
            turn = point.along_share / (point.along_share - found.along_share)
            nose = point.share + 0.5 * turn * step * point.along_share
            told = point.share + 0.5 * step * (point.along_share + found.along_share)
            if abs(told - found.share) <= NOSE_TOLERANCE or step <= SHORTEST:
                return tree.read("none", point, nose)
            length = step / 2
            continue
        point = found
        length = min(2 * step, LONGEST) if corrections <= FEW_CORRECTIONS else step
    return tree.read("not found", point, point.share)


def _corrected(tree: _Tree, point: _Point, step: float, last: bool) -> tuple[_Point, int] | None:
    """The point of the curve a step ahead, and the Newton steps it took; None if not found.

    The step before the last injections keeps their share at 1, any other its length along the
    curve: near the nose the share does not tell where on the curve a point is, the length does.
    """
    x = point.x + step * point.along
    share = 1.0 if last else point.share + step * point.along_share
    across = tree.weights() * point.along
    for corrections in range(MAX_CORRECTIONS + 1):
        residual = tree.residual(x, share)
        if not np.isfinite(residual).all():
            return None
        if tree.reached(residual) and corrections:
            found = _heading(tree, _Point(x, share, point.along, point.along_share))
            return found, corrections
        factors = splu(tree.slope(x))
        by_residual = factors.solve(-residual)
        if last:
            x = x + by_residual
            continue
        by_share = factors.solve(-tree.by_share())
        # Perpendicular to the direction of the step: across . dx + along_share dshare = 0.
        change = -(across @ by_residual) / (across @ by_share + point.along_share)
        x = x + by_residual + change * by_share
        share += float(change)
    return None


def _heading(tree: _Tree, point: _Point) -> _Point:
    """Point with the curve's direction at it, of length 1 and never backwards."""
    by_share = splu(tree.slope(point.x)).solve(-tree.by_share())
    weights = tree.weights()
    length = float(np.sqrt(weights @ by_share**2 + 1.0))
    onwards = float((weights * point.along) @ by_share + point.along_share)
    sign = 1.0 if onwards >= 0 else -1.0
    return _Point(point.x, point.share, sign * by_share / length, sign / length)
