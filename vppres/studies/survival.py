"""How likely a site keeps supply through an outage, by the outage's beginning and its length.

Outages begin at every step of a scenario, or at a sample of its steps. Each is a run of its own: of
outages whose end is known one for each length, else one of the longest, since what a controller
does in an outage does not depend on an end that it does not know. The series of a scenario repeat
behind its last step.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.arrays import Flags, Floats, Wholes
from vppres.core.errors import InputError, SolveError, StorageError, VerificationError
from vppres.day.options import RunOptions
from vppres.day.series import off_kw
from vppres.day.simulate import Progress, run_day
from vppres.day.trajectory import WHOLE_SHARE
from vppres.io.atomic import atomic_write_text, is_full
from vppres.io.digest import scenario_digest
from vppres.scenario.assets import Customers
from vppres.scenario.parts import split_sheddable
from vppres.scenario.scenario import Scenario
from vppres.studies.side_by_side import FailedJob, Where, identity, map_unordered
from vppres.studies.sweep_parameters import Value, changed, find_parameter, read_values

LENGTHS_H = (1.0, 2.0, 4.0, 8.0, 12.0, 24.0, 48.0)
"""Lengths that are tried where none are given, as far as they are whole steps."""

LONGEST_H = 48.0
ONSETS = 200
"""Beginnings that are tried where no number is given."""

AT_A_TIME = 8
"""Onsets of a job: enough that its file and its process cost little beside them."""

PIECES, MARK = "pieces", "survival.json"
KNOWN = "known"
PAPER = "paper"
SCALED = ("batteries", "pv", "load")
_Z95 = 1.959964
_DIGITS = 6


@dataclass(frozen=True)
class Tried:
    """Choice of the outages that are tried."""

    lengths_h: tuple[float, ...]  #: lengths in h, ascending
    #: How many beginnings; all steps where there are no more, else drawn with ``seed``.
    onsets: int = ONSETS
    #: State of charge of all batteries when an outage begins; that of operation without outages if
    #: not given.
    charged: float | None = None
    seed: int = 0  #: of the drawing

    def __post_init__(self) -> None:
        for wrong, field, value, cure in (
            (self.onsets < 1, "onsets", self.onsets, "Give 1 or more."),
            (
                not self.lengths_h or min(self.lengths_h) <= 0 or max(self.lengths_h) > LONGEST_H,
                "lengths",
                ",".join(f"{hours:g}" for hours in self.lengths_h),
                f"Give hours above 0, up to {LONGEST_H:g}.",
            ),
            (
                self.charged is not None and not 0.0 <= self.charged <= 1.0,
                "charged",
                self.charged,
                "Give a share from 0 to 1.",
            ),
        ):
            if wrong:
                raise InputError.of("survival", "is out of range", cure, field=field, value=value)


@dataclass(frozen=True)
class OutageOutcome:
    """Supply of customers in an outage."""

    #: The step in which it begins, and its length.
    onset: int
    steps: int
    #: Steps that each customer kept supply until it first lost a part of it, and all steps in which
    #: it had supply.
    kept: list[int]
    supplied: list[int]
    #: Steps in which all customers of a tier had supply, for each tier of the scenario.
    together: list[int]
    unserved_kwh: float  #: demand that was not supplied in it


@dataclass(frozen=True, eq=False)
class Start:
    """A stretch of a scenario without outages: the first ``lead`` steps come before the onset."""

    onset: int
    site: Scenario


@dataclass(frozen=True, eq=False)
class Job:
    """Some onsets of one variant of the site, under the digest of all that they depend on."""

    variant: str
    key: str
    starts: tuple[Start, ...]
    lead: int
    lengths: tuple[int, ...]
    options: RunOptions


@dataclass(frozen=True, eq=False)
class Variant:
    """The site as it is, or with something larger or smaller."""

    name: str
    site: Scenario
    options: RunOptions

    @cached_property
    def customers(self) -> Customers:
        """Customers as runs have them: each part of a divided one is one."""
        return split_sheddable(self.site).customers


@dataclass(frozen=True, eq=False)
class Survival:
    """Outcomes of all outages: one list for each variant."""

    tried: Tried
    lengths: tuple[int, ...]
    variants: tuple[Variant, ...]
    outcomes: dict[str, list[OutageOutcome]]
    every_step: bool

    @cached_property
    def dt_h(self) -> float:
        """Length of a step in h."""
        return self.variants[0].site.grid.dt_h

    def _of(self, variant: str, steps: int, name: str) -> Any:
        """Values of a field in the outcomes of a length, a row for each onset."""
        found = [one for one in self.outcomes[variant] if one.steps == steps]
        return np.array([getattr(one, name) for one in found])

    def table(self) -> pd.DataFrame:
        """A row for each variant, length and tier: share of onsets, hours, energy not supplied.

        ``low`` and ``high`` are the ends of Wilson's interval of 95%; they are the share itself
        where every step was tried.
        """
        rows = []
        for variant in self.variants:
            customers = variant.customers
            for steps in self.lengths:
                kept, together, unserved_kwh = (
                    self._of(variant.name, steps, name)
                    for name in ("kept", "together", "unserved_kwh")
                )
                for i, tier in enumerate(variant.site.tiers):
                    of_tier = customers.tier == tier
                    if not of_tier.any() or not len(kept):
                        continue
                    least = kept[:, of_tier].min(axis=1)
                    share, low, high = self._share(least >= steps)
                    rows.append(
                        {
                            "variant": variant.name,
                            "length_h": steps * self.dt_h,
                            "tier": tier,
                            "onsets": len(kept),
                            "throughout": share,
                            "low": low,
                            "high": high,
                            "expected_h": float(together[:, i].mean()) * self.dt_h,
                            "until_loss_h": float(least.mean()) * self.dt_h,
                            "not_supplied_kwh": float(unserved_kwh.mean()),
                        }
                    )
        return pd.DataFrame(rows)

    def customers(self) -> pd.DataFrame:
        """A row for each variant, length and customer."""
        rows = []
        for variant in self.variants:
            for steps in self.lengths:
                kept, supplied = (
                    self._of(variant.name, steps, name) for name in ("kept", "supplied")
                )
                for c in range(kept.shape[1] if len(kept) else 0):
                    share, low, high = self._share(kept[:, c] >= steps)
                    rows.append(
                        {
                            "variant": variant.name,
                            "length_h": steps * self.dt_h,
                            "customer": variant.customers.id[c],
                            "tier": variant.customers.tier[c],
                            "throughout": share,
                            "low": low,
                            "high": high,
                            "expected_h": float(supplied[:, c].mean()) * self.dt_h,
                            "until_loss_h": float(kept[:, c].mean()) * self.dt_h,
                        }
                    )
        return pd.DataFrame(rows)

    def by_onset(self) -> pd.DataFrame:
        """A row for each variant, onset and length: hours that each tier kept supply."""
        rows = []
        for variant in self.variants:
            grid, customers = variant.site.grid, variant.customers
            present = [tier for tier in variant.site.tiers if (customers.tier == tier).any()]
            for one in self.outcomes[variant.name]:
                kept = np.array(one.kept)
                hours = {
                    f"kept_h.{tier}": float(kept[customers.tier == tier].min()) * self.dt_h
                    for tier in present
                }
                rows.append(
                    {
                        "variant": variant.name,
                        "onset": (grid.start + one.onset * grid.step).isoformat(),
                        "length_h": one.steps * self.dt_h,
                        **hours,
                        "not_supplied_kwh": one.unserved_kwh,
                    }
                )
        return pd.DataFrame(rows)

    def _share(self, yes: Any) -> tuple[float, float, float]:
        """Share of onsets with the ends of its interval."""
        share, count = float(np.mean(yes)), len(yes)
        if self.every_step:
            return share, share, share
        return share, *wilson(share, count)


def wilson(share: float, count: int) -> tuple[float, float]:
    """Ends of Wilson's interval of 95% of a share of so many draws.

    >>> [round(end, 3) for end in wilson(0.5, 100)]
    [0.404, 0.596]
    """
    below = 1.0 + _Z95**2 / count
    middle = (share + _Z95**2 / (2.0 * count)) / below
    half = _Z95 / below * np.sqrt(share * (1.0 - share) / count + _Z95**2 / (4.0 * count**2))
    return max(float(middle - half), 0.0), min(float(middle + half), 1.0)


def lengths_of(text: str | None, dt_h: float) -> tuple[float, ...]:
    """Lengths in h of a text ``1,2,4``; the usual ones that are whole steps if none is given."""
    if text is None:
        return tuple(h for h in LENGTHS_H if (h / dt_h).is_integer()) or (dt_h,)
    try:
        hours = tuple(sorted({float(part) for part in text.split(",")}))
    except ValueError:
        hours = ()
    if not hours or not all((h / dt_h).is_integer() for h in hours):
        raise InputError.of(
            "survival",
            f"are not hours in whole steps of {dt_h:g} h",
            "Write for example 1,2,4,8.",
            field="--lengths",
            value=text,
        )
    return hours


def variants_of(site: Scenario, options: RunOptions, scale: str | None) -> tuple[Variant, ...]:
    """The site, or one variant for each factor of ``batteries=0.5,1,2``."""
    site = without_outages(site)
    if scale is None:
        return (Variant("as given", site, options),)
    name, _, values = scale.partition("=")
    if name not in SCALED:
        raise InputError.of(
            "survival",
            f"must be one of {', '.join(SCALED)} and factors",
            "Write for example batteries=0.5,1,2.",
            field="--scale",
            value=scale,
        )
    parameter = find_parameter(f"scale.{name}", site)
    factors: Sequence[Value] = read_values(parameter, values)
    return tuple(
        Variant(f"{name} x {factor:g}", *changed(parameter, factor, site, options))
        for factor in factors
    )


def without_outages(site: Scenario) -> Scenario:
    """The site with grid in every step, and without messages about outages."""
    limit_kw = np.where(site.outage, np.inf, site.grid_limit_kw)
    return replace(site, grid_limit_kw=limit_kw, warnings=())


def survival(
    variants: Sequence[Variant],
    tried: Tried,
    folder: Path,
    where: Where | None = None,
    progress: Progress | None = None,
) -> Survival:
    """Try all outages; what is finished is kept in the folder, and not tried again.

    Parameters
    ----------
    variants : sequence of Variant
        Of :func:`variants_of`.
    tried : Tried
        Which outages.
    folder : Path
        Where finished pieces are kept: a study that was interrupted goes on where it stopped.
    where : Where, optional
        Processes of this machine, or a cluster.
    progress : callable, optional
        Called as ``progress(onsets done, onsets in all)``.

    Raises
    ------
    InputError
        If no outage fits, or the folder holds something else.
    SolveError
        If an outage has no answer, or its process died.
    """
    with kept_in(folder):
        begin(folder)
        return _tried(variants, tried, folder, where, progress)


@contextmanager
def kept_in(folder: Path) -> Iterator[None]:
    """Say what is kept of a study that breaks off, and why its folder takes no more."""
    goes_on = f"what is finished is kept in {folder}, and the same command goes on."
    try:
        yield
    except KeyboardInterrupt as interrupt:
        interrupt.add_note(goes_on)
        raise
    except OSError as error:
        if is_full(error):
            raise StorageError(f"The disk is full, or a quota is reached; {goes_on}") from error
        if error.filename is None:
            raise
        raise InputError.of(
            str(folder),
            f"cannot be written ({error.strerror})",
            "Choose another folder, or check its permissions.",
        ) from error


def _tried(
    variants: Sequence[Variant],
    tried: Tried,
    folder: Path,
    where: Where | None,
    progress: Progress | None,
) -> Survival:
    """All outages, those of an earlier run from its folder."""
    dt_h = variants[0].site.grid.dt_h
    lengths = tuple(round(hours / dt_h) for hours in tried.lengths_h)
    possible = _possible(variants[0], tried, max(lengths))
    onsets = _drawn(possible, tried)
    jobs: list[Job] = []
    found: dict[str, list[OutageOutcome]] = {variant.name: [] for variant in variants}
    done, total = 0, len(onsets) * len(variants)
    for variant in variants:
        for job in _jobs(variant, tried, onsets, lengths, folder):
            if known := _kept(folder, job.key):
                found[variant.name] += known
                done += len(job.starts)
            else:
                jobs.append(job)
    if progress:
        progress(done, total)
    with closing(map_unordered(run_job, jobs, where)) as outcomes:
        for outcome in outcomes:
            if isinstance(outcome, FailedJob):
                raise SolveError(f"{outcome.job.variant}: {outcome.reason} Run again to try it.")
            text = json.dumps([asdict(one) for one in outcome.result])
            atomic_write_text(folder / PIECES / f"{outcome.job.key}.json", text)
            found[outcome.job.variant] += outcome.result
            done += len(outcome.job.starts)
            if progress:
                progress(done, total)
    ordered = {
        name: sorted(each, key=lambda one: (one.onset, one.steps)) for name, each in found.items()
    }
    whole = len(onsets) == variants[0].site.grid.n_steps
    return Survival(tried, lengths, tuple(variants), ordered, whole)


def begin(folder: Path) -> None:
    """Make the folder of a study, or go on with that of an earlier one."""
    if folder.exists() and not (folder / MARK).is_file() and any(folder.iterdir()):
        raise InputError.of(
            str(folder),
            f"exists and is not the folder of such a study (it has no {MARK})",
            "Choose another name, or remove it.",
        )
    (folder / PIECES).mkdir(parents=True, exist_ok=True)
    if not (folder / MARK).exists():
        atomic_write_text(folder / MARK, "{}\n")


def run_job(job: Job) -> list[OutageOutcome]:
    """Try the outages of a job."""
    found = []
    for start in job.starts:
        try:
            found += [*_outcomes(job, start)]
        except (SolveError, VerificationError) as error:
            time = start.site.grid.start + job.lead * start.site.grid.step
            raise type(error)(f"{job.variant}, outage from {time.isoformat()}: {error}") from error
    return found


def _outcomes(job: Job, start: Start) -> Iterator[OutageOutcome]:
    """Every length of an outage: of one whose end is not known all from the longest."""
    known = job.options.outages == KNOWN
    first = job.lead
    for each in job.lengths if known else job.lengths[-1:]:
        limit_kw = start.site.grid_limit_kw.copy()
        limit_kw[first : first + each if known else None] = 0.0
        site = replace(start.site, grid_limit_kw=limit_kw)
        run = run_day(site, job.options, steps=first + each)
        lost: Flags = np.asarray(run.supplied[first:] < WHOLE_SHARE)
        off_kwh = off_kw(run)[first:] * site.grid.dt_h
        tier = run.scenario.customers.tier
        whole: list[Flags] = [np.all(~lost[:, tier == name], axis=1) for name in site.tiers]
        # The last row stands for what lasted to the end.
        ends = np.vstack([lost, np.ones(lost.shape[1], dtype=bool)]).argmax(axis=0)
        for steps in (each,) if known else job.lengths:
            kept = np.minimum(ends, steps).tolist()
            missing_kwh = round(float(off_kwh[:steps].sum()), _DIGITS)
            supplied = (~lost[:steps]).sum(axis=0).tolist()
            together = [int(each_step[:steps].sum()) for each_step in whole]
            yield OutageOutcome(start.onset, steps, kept, supplied, together, missing_kwh)


def _lead(variant: Variant, tried: Tried) -> int:
    """Steps before an outage in which the controller may see it come."""
    if tried.charged is not None or variant.options.outages != KNOWN:
        return 0
    return variant.site.grid.steps_in_horizon(variant.options.horizon_h)


def _reach(variant: Variant, longest: int) -> int:
    """Steps from the onset on that a run may look at."""
    return longest + variant.site.grid.steps_in_horizon(variant.options.horizon_h)


def _possible(variant: Variant, tried: Tried, longest: int) -> Wholes:
    """Steps at which outages may begin: all, unless something in the site has dates."""
    site, options = variant.site, variant.options
    dated = len(site.sessions) or len(site.refuels) or options.forecaster != PAPER
    first, last = 0, site.grid.n_steps
    if dated:
        first, last = _lead(variant, tried), last - _reach(variant, longest) + 1
    if first >= last:
        raise InputError.of(
            "survival",
            f"does not fit into {site.grid.n_steps} steps that cannot repeat: vehicles, deliveries "
            "of fuel and histories of forecasts have dates",
            "Give shorter lengths, or a longer scenario.",
            field="lengths",
            value=f"{max(tried.lengths_h):g} h",
        )
    return np.arange(first, last)


def _drawn(possible: Wholes, tried: Tried) -> list[int]:
    """Onsets that are tried: all, or some drawn by chance."""
    if tried.onsets >= len(possible):
        return [int(t) for t in possible]
    rng = np.random.default_rng(tried.seed)
    return sorted(int(t) for t in rng.choice(possible, tried.onsets, replace=False))


def _jobs(
    variant: Variant, tried: Tried, onsets: Sequence[int], lengths: tuple[int, ...], folder: Path
) -> Iterator[Job]:
    lead, reach = _lead(variant, tried), _reach(variant, max(lengths))
    settings = {
        "site": scenario_digest(variant.site),
        "options": variant.options.as_record(),
        "charged": tried.charged,
        "lengths": lengths,
        "sources": identity(),
    }
    base = json.dumps(settings, sort_keys=True, default=str)
    soc = _charge(variant, tried, folder, base)
    for i in range(0, len(onsets), AT_A_TIME):
        some = onsets[i : i + AT_A_TIME]
        starts = tuple(
            Start(t, _stretch(variant, t - lead, t + reach, soc[(t - lead) % len(soc)]))
            for t in some
        )
        key = sha256(f"{base} {some}".encode()).hexdigest()
        yield Job(variant.name, key, starts, lead, lengths, variant.options)


def _stretch(variant: Variant, first: int, last: int, soc: Floats) -> Scenario:
    """Steps of a site whose series repeat, with the batteries as charged as they are then."""
    site = variant.site
    grid = replace(site.grid, start=site.grid.start + first * site.grid.step, n_steps=last - first)
    at = np.arange(first, last) % site.grid.n_steps
    history = None
    if variant.options.forecaster != PAPER and site.history is not None:
        before = slice(0, first)
        history = site.history.followed_by(
            site.grid.start, site.load_kw[before], site.pv_kw[before]
        )
    batteries = site.batteries
    soc = np.clip(soc, batteries.soc_min, batteries.soc_max)
    rows: dict[str, Any] = {name: values[at] for name, values in site.series.items()}
    return replace(
        site, grid=grid, history=history, batteries=replace(batteries, soc_initial=soc), **rows
    )


def _charge(variant: Variant, tried: Tried, folder: Path, base: str) -> Floats:
    """State of charge of the batteries at the beginning of each step, (T, B)."""
    site = variant.site
    count = len(site.batteries)
    if tried.charged is not None or not count:
        return np.full((1, count), tried.charged or 0.0)
    file = folder / PIECES / f"normal-{sha256(base.encode()).hexdigest()}.json"
    if not file.is_file():
        run = run_day(site, variant.options)
        soc = run.by_step("batteries", "soc_start").astype(float)
        atomic_write_text(file, json.dumps(soc.tolist()))
    return np.array(json.loads(file.read_text(encoding="utf-8")), dtype=float)


def _kept(folder: Path, key: str) -> list[OutageOutcome]:
    """Outcomes of a job in an earlier run; none if it was not there."""
    file = folder / PIECES / f"{key}.json"
    if not file.is_file():
        return []
    return [OutageOutcome(**one) for one in json.loads(file.read_text(encoding="utf-8"))]
