"""Lines of a feeder that act as one in the tie-breakers, where only batteries and PV systems move.

Along a chain of lines the flow is what moves behind it plus what is known, so the sum of
``r P**2`` is ``R`` times the square of the mean flow, weighted by ``r``, plus what is known. A bus
between has its share of each end of the chain, by resistance. So the sums of the balances with
these shares say the same of the mean flows as all of them do of all flows: nothing is left out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from vppres.core.arrays import Floats, Wholes
from vppres.model.site import Site
from vppres.solve.selection import Family, Sheet

FLOWS = {"P_flow": "P_chain", "Q_flow": "Q_chain"}
"""Letters of the lines, and of the chains' mean flows."""

OF_NO_CHAIN = -1
"""The chain of a line behind which nothing moves."""


@dataclass(frozen=True, eq=False)
class Chains:
    """Chains of a feeder's lines between K buses that stay; each but the first ends one."""

    shares: sp.csr_array  #: what each bus that stays has of each bus, (K, N)
    chain: Wholes  #: chain of each line, ``OF_NO_CHAIN`` where nothing moves behind it, (L,)
    line: Wholes  #: a line of each chain, (K - 1,)
    factor: Floats  #: what the mean flow has of that line's, (K - 1,)

    @classmethod
    def of(cls, site: Site) -> Chains:
        """Chains between the buses of batteries, PV systems, the grid and branchings."""
        net = site.network
        L, N = net.n_lines, net.n_buses
        fed = np.arange(N) == 0
        for at_bus in (site.battery_bus, site.pv_bus):
            fed = fed | (np.asarray(abs(at_bus).sum(axis=1)).ravel() > 0.0)
        stays = fed.copy()
        ways = np.zeros(N, dtype=int)
        upwards = range(L - 1, -1, -1)
        for line in upwards:
            if fed[line + 1]:
                fed[net.parent[line]] = True
                ways[net.parent[line]] += 1
        stays |= ways > 1
        lower = np.arange(N)
        for line in upwards:
            if fed[line + 1] and not stays[net.parent[line]]:
                lower[net.parent[line]] = lower[line + 1]
        fed_lines = np.flatnonzero(fed[1:])
        ends = lower[fed_lines + 1]
        total = np.bincount(ends, net.r_ohm[fed_lines], minlength=N)
        # A chain without resistance counts nothing: any share does.
        length = np.where(total[lower[1:]] > 0.0, net.r_ohm, 1.0)
        total = np.bincount(ends, length[fed_lines], minlength=N)
        upper, anchor, far = np.zeros(N, dtype=int), np.arange(N), np.zeros(N)
        for line, above in enumerate(net.parent):
            bus = line + 1
            upper[bus] = above if stays[above] else upper[above]
            far[bus] = length[line] + (0.0 if stays[above] else far[above])
            anchor[bus] = bus if fed[bus] else anchor[above]
        place = np.cumsum(stays) - 1
        between = np.flatnonzero(fed & ~stays)
        below = far[between] / total[lower[between]]
        own = np.flatnonzero(stays)
        values = np.concatenate([np.ones(len(own)), below, 1.0 - below])
        rows = place[np.concatenate([own, lower[between], upper[between]])]
        columns = np.concatenate([own, between, between])
        of_fed = sp.csr_array((values, (rows, columns)), shape=(len(own), N))
        chain = np.full(L, OF_NO_CHAIN)
        chain[fed_lines] = place[ends] - 1
        longest = fed_lines[np.argsort(length[fed_lines], kind="stable")]
        first = np.zeros(len(own) - 1, dtype=int)
        first[chain[longest]] = longest
        shares = sp.csr_array(of_fed[:, anchor])
        return cls(shares, chain, first, length[first] / total[own[1:]])

    def of_balance(self, sheet: Sheet, name: str) -> Family:
        """A family of balances as sums of its rows, on the mean flows."""
        family = sheet.family(name)
        W, _ = family.shape
        moved = {letter: self._columns(sheet, letter) for letter in FLOWS}
        size = sheet.size
        kept = np.ones(size + 1)
        gone = [np.ravel(sheet.columns[letter]) for letter in FLOWS]
        kept[np.concatenate(gone)] = 0.0
        places = [np.concatenate(each) for each in zip(*moved.values(), strict=True)]
        values = np.tile(np.repeat(1.0 / self.factor, W), len(FLOWS))
        turned = sp.coo_array((values, tuple(places)), shape=(size + 1, size + 1))
        T = sp.csr_array(sp.diags_array(kept) + turned)
        rows = family.rows.wider(size).times(sp.kron(self.shares, sp.eye_array(W)), T)
        letters = (*family.letters, *FLOWS.values())
        used = tuple(letter for letter in letters if sheet.used(letter, rows))
        return replace(family, rows=rows, shape=(W, len(self.line) + 1), letters=used)

    def _columns(self, sheet: Sheet, letter: str) -> tuple[Wholes, Wholes]:
        """Columns of the chains' own lines, and of their mean flows."""
        shape = (sheet.n_steps, len(self.line))
        mean = sheet.new_letter(FLOWS[letter], shape, -np.inf)
        lines = sheet.columns[letter][:, self.line]
        return np.ravel(lines, order="F"), np.ravel(mean, order="F")

    def squares(self, of_lines: Mapping[str, Floats]) -> dict[str, Floats]:
        """Weights of squares with those of the lines added up over their chains."""
        inside = self.chain != OF_NO_CHAIN
        found: dict[str, Floats] = {}
        for letter, weight in of_lines.items():
            if letter not in FLOWS:
                found[letter] = weight
            else:
                of_chain = np.bincount(self.chain[inside], weight[inside], len(self.line))
                found[FLOWS[letter]] = of_chain.astype(float)
        return found
