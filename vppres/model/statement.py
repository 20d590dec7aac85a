"""The one statement of a window's problem: the paper's page with what the window has beyond it.

Every row belongs to a family and every column to a letter, both by name. What a method solves is a
selection of them; see :mod:`vppres.solve.selection`.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property

import cvxpy as cp
import numpy as np

from vppres.contract.dispatch import Dispatch
from vppres.core.arrays import Flags, Floats
from vppres.core.errors import ModelError
from vppres.model import objective, problem
from vppres.model.beyond_paper.addition import AdditionDispatch
from vppres.model.beyond_paper.former_phases import drawn_by_assets
from vppres.model.beyond_paper.table import PROVEN, Beyond
from vppres.model.constraints import Named
from vppres.model.data import WindowData
from vppres.model.equations import EQUATIONS
from vppres.model.implied import IMPLIED
from vppres.model.own_page import changed_families, own_term
from vppres.model.site import Site
from vppres.model.variables import Parameters, Variables

NETWORK = frozenset({"P_flow", "Q_flow", "u", "Q_pv", "Q_batt"})
"""The paper's letters that a relaxation without the network has not."""


DRAWN = ("drawn_kw", "drawn_kvar")
"""Active and reactive power of the assets of a feeder with phases."""


class Statement:
    """Families, letters, terms and parameters of a window of W steps.

    Parameters
    ----------
    site : Site
        Fixed data.
    n_steps : int
        Steps W of the window.
    beyond : tuple, optional
        What it has beyond the paper.

    Attributes
    ----------
    v, p : Variables, Parameters
        The paper's.
    drawn : dict
        Power of each asset of a feeder with phases, as rows that no problem has.
    families : dict
        Constraints by the names of their families.
    implied : dict
        The same that follow from them: a relaxation without some of them keeps these.
    terms : dict
        Terms of the objective as they are before they are weighted; ``own`` has what the page's
        objective, or your own part, has besides.
    own : tuple of str
        Families for which the stages of the paper's problem have no proof, and ``own`` if there
        is such a term.
    rules : set of str
        Families on service alone, which a known service meets or does not.
    changed : tuple of str
        Families of the paper that the page lacks, or states in another way.

    Raises
    ------
    ModelError
        If a family is not disciplined (DPP): it would be compiled anew at every solve. If one of
        your own, or such a term, is not linear.
    """

    def __init__(self, site: Site, n_steps: int, beyond: Beyond = ()) -> None:
        self.site = site
        self.n_steps = n_steps
        v = Variables(site, n_steps)
        self.additions = [each.create(site, v, shape) for each, shape in beyond]
        self._own_parts = [each for each in self.additions if type(each) not in PROVEN]
        p = self._with_additions(v, Parameters(site, n_steps))
        self.v = v
        self.p = p
        paper = problem.paper_constraints(site, v, p)
        self._written: tuple[WindowData, Floats] | None = None
        self.rules: frozenset[str] = frozenset()
        self._own_families: Named = {}
        self.families = self._families(paper)
        self.implied: Named = {}
        for family in IMPLIED:
            self.implied |= family(site, v, p)
        self.implied_beyond: Named = {}
        for addition in self.additions:
            self.implied_beyond |= addition.implied(site, v, p)
        self.implied |= self.implied_beyond
        self.drawn: Named = {}
        if p.by_asset is not None:
            self.drawn = {n: drawn <= 0.0 for n, drawn in zip(DRAWN, p.by_asset, strict=True)}
        self.F = problem.paper_objective(site, v, p)
        self.terms = self._terms()
        self.changed = changed_families(paper, site, v, p)
        self.own = self._own_names(paper)
        self._named = named = self.families | self.implied
        for name, constraint in named.items():
            if not constraint.is_dcp(dpp=True):
                raise ModelError(
                    f"The family {name} is not DPP: a parameter multiplies a parameter or "
                    "enters non-affinely. Move the product into the parameter's value."
                )
        parts = [*named.values(), *self.terms.values(), self.F, *self.drawn.values()]
        found = [q for part in parts for q in part.parameters()]
        self.parameters: list[cp.Parameter] = list({q.id: q for q in found}.values())
        letters = [x for part in parts for x in part.variables()]
        self.letters: dict[str, cp.Variable] = {x.name(): x for x in letters}
        if len(self.letters) < len({x.id for x in letters}):
            raise ModelError("Two variables of the problem have the same name.")

    def _with_additions(self, v: Variables, p: Parameters) -> Parameters:
        """The parameters with what additions set of them; what is added is summed."""
        for addition in self.additions:
            added = [*addition.parameters(self.site).items()]
            for taker, powers in addition.taken(self.site).items():
                place = self.site.taking_bus[taker].T
                pairs = zip(("P_added", "Q_added"), powers, strict=True)
                added += [(letter, power @ place) for letter, power in pairs if power is not None]
            for name, value in added:
                before = getattr(p, name) if name.endswith("_added") else None
                setattr(p, name, value if before is None else before + value)
        if self.site.phases:
            taken = [addition.taken(self.site) for addition in self.additions]
            p.by_asset = drawn_by_assets(self.site, v, p, taken)
        return p

    def _own_names(self, paper: Named) -> tuple[str, ...]:
        """Families of the page and of additions without a proof in any stage, and their term."""
        named = {name: c for name, c in paper.items() if name not in EQUATIONS}
        named |= self._own_families
        for name, constraint in named.items():
            # Maxima and absolute values may stand in linear rows.
            of_lines = all(side.is_pwl() for side in constraint.args)
            if isinstance(constraint, cp.SOC) or not of_lines:
                raise ModelError(
                    f"The family {name} is not linear. State it by linear rows, with variables of "
                    "its own where it needs any."
                )
        return (*named, *(("own",) if "own" in self.terms else ()))

    def _families(self, paper: Named) -> Named:
        """The paper's families, then those of the additions; one that is replaced gives way."""
        args = (self.site, self.v, self.p)
        named = paper
        for addition in self.additions:
            kept = {n: c for n, c in named.items() if n not in addition.replaces}
            more = addition.families(*args)
            named = kept | more
            if addition in self._own_parts:
                self._own_families |= more
            elif addition.rules:
                self.rules |= more.keys()
        return named

    def _terms(self) -> dict[str, cp.Expression]:
        """The paper's linear terms, with what additions put into them, and theirs."""
        args = (self.site, self.v, self.p)
        terms = {
            "f1": objective.f1_service(*args),
            "f2": objective.f2_cost(*args),
            "f3": objective.f3_curtailment(*args),
        }
        own = own_term(self.F, self.site, self.v, self.p)
        if own is not None:
            terms["own"] = own
        for addition in self.additions:
            for name, term in addition.terms().items():
                terms[name] = terms[name] + term if name in terms else term
        return terms

    @cached_property
    def network_letters(self) -> frozenset[str]:
        """Letters that a relaxation without the network has not."""
        return NETWORK.union(self.named("of_network"))

    @property
    def own_letters(self) -> frozenset[str]:
        """Letters that your own families and term use."""
        of_term = {x.name() for x in self.terms["own"].variables()} if "own" in self.own else ()
        families = (self.letters_of(name) for name in self.own if name != "own")
        return frozenset().union(of_term, *families)

    @property
    def differs(self) -> tuple[str, ...]:
        """How the page differs from the paper's: families by name, ``own`` for a term of F."""
        return self.own + self.changed

    @property
    def minds_network(self) -> bool:
        """Whether what differs needs the network, or what follows from the paper may not hold."""
        return bool(self.changed or self.own_letters & self.network_letters)

    @property
    def minds_service(self) -> bool:
        """Whether what differs from the paper may ask for other service or import than it.

        Not where your own families have letters of their own alone, which balances join to the
        paper's, and there is no term.
        """
        paper = {x.name() for x in vars(self.v).values() if isinstance(x, cp.Variable)}
        joined = self.changed or "own" in self.terms or self.own_letters & paper
        return bool(self.differs and joined)

    def letters_of(self, family: str) -> frozenset[str]:
        """Letters that a family uses."""
        return frozenset(x.name() for x in self._named[family].variables())

    def named(self, kind: str) -> tuple[str, ...]:
        """Letters or families that additions name as of a kind, of those that there are."""
        names = (name for each in self.additions for name in getattr(each, kind))
        known = self.letters.keys() | self.families.keys() | self.implied.keys()
        return tuple(n for n in names if n in known)

    def held(self, data: WindowData, dispatch: Dispatch) -> AdditionDispatch:
        """Part of a dispatch's additions that the tie-breakers hold."""
        found = [each.of_dispatch(self.site, data, dispatch) for each in self.additions]
        return AdditionDispatch(
            {name: value for each in found for name, value in each.values.items()},
            {name: ends for each in found for name, ends in each.ranges.items()},
            sum(each.gbp for each in found),
        )

    def write(self, data: WindowData) -> Floats:
        """All parameters of a window one after the other, with a 1 behind them.

        Problems of a window are written with the same numbers, one after the other.
        """
        if self._written is not None and self._written[0] is data:
            return self._written[1]
        self.p.fill(self.site, data)
        for addition in self.additions:
            addition.fill(self.site, data)
        values = [np.ravel(q.value, order="F") for q in self.parameters]
        numbers = np.concatenate([*values, np.ones(1)])
        self._written = data, numbers
        return numbers

    def dispatch(self, served: Flags | None = None) -> Dispatch:
        """The letters' values as a dispatch, of a supply schedule if service is held."""
        found = self.v.dispatch(self.site, served)
        for addition in self.additions:
            found = addition.read(found)
        return found

    def put(self, values: Mapping[str, Floats]) -> None:
        """Give the letters the values of a solution, by their names."""
        for name, value in values.items():
            self.letters[name].save_value(value)
