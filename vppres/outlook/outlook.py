"""From warnings, statistics and what has been seen to the belief at a step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from vppres.core.arrays import Floats
from vppres.outlook import durations, restoration
from vppres.outlook.belief import OutageBelief
from vppres.outlook.presets import Statistics, completed
from vppres.scenario.outage_warnings import OnsetShares, OutageStatistics, OutageWarning

HOUR = pd.Timedelta(hours=1)

BEYOND = 0.1 + 1e-9
"""Share of lengths beyond the last quantile of a message: when only these are left it is outlasted,
and what it says of them is a guess."""

LONGEST_STEPS = 3000
"""Lengths that are distinguished; longer ones are as long."""


@dataclass(frozen=True)
class SeenOutage:
    """An outage that was seen: its first step, and the first step after it, None while it lasts."""

    start: pd.Timestamp
    end: pd.Timestamp | None = None

    @property
    def lasts(self) -> bool:
        """Whether it is not over."""
        return self.end is None

    @property
    def hours(self) -> float:
        """Its length in h, NaN while it lasts."""
        return (self.end - self.start) / HOUR if self.end else np.nan


@dataclass(frozen=True)
class Announced:
    """An announced outage as its messages so far leave it: the last one, and its onset."""

    message: OutageWarning  #: the last one, with what it leaves out as those before it said it
    first_issued: pd.Timestamp  #: when it was first announced
    #: When it begins.
    earliest: pd.Timestamp
    likely: pd.Timestamp
    latest: pd.Timestamp
    shares: OnsetShares | None = None  #: the same as a distribution
    #: Whether the length of ``message`` was said of an outage that had begun.
    estimate: bool = False
    #: Before it the grid is not back: what was last said of it, unless a length was said later.
    not_before: pd.Timestamp | None = None
    notices: tuple[OutageWarning, ...] = ()  #: messages that said by when it is
    #: Names of the messages that this one replaces, where it has another name.
    dropped: tuple[str, ...] = ()

    @property
    def words(self) -> str:
        """Which message counts, and which do not for it; empty where there is only one."""
        if not self.dropped:
            return ""
        others = ", ".join(map(_named, self.dropped))
        return f"{_named(self.message.outage)} counts, not {others}"

    @property
    def spread_h(self) -> float:
        """How much is left open of its beginning and its length, in h."""
        message = self.message
        onset_h = float((self.latest - self.earliest) / HOUR)
        if not message.says_length:
            return np.inf
        if message.duration_p50_h is None:
            return onset_h
        shortest_h = message.duration_p10_h or message.duration_p50_h
        longest_h = message.duration_p90_h or message.duration_p50_h
        return onset_h + longest_h - shortest_h

    @property
    def sure(self) -> bool:
        """Whether it comes for certain, at a time that is known."""
        return self.message.probability == 1.0 and self.earliest == self.latest

    def off(self, seen: SeenOutage) -> pd.Timedelta:
        """How far an outage that was seen began from the announced time."""
        return max(self.earliest - seen.start, seen.start - self.latest, pd.Timedelta(0))

    def explains(self, seen: SeenOutage, step: pd.Timedelta) -> bool:
        """Whether an outage that was seen is this one.

        It began in the announced time, or off by its width, an hour at least; and not before
        it was known.
        """
        most = max(self.latest - self.earliest, HOUR, step)
        known = not seen.end or seen.end > self.first_issued
        return known and self.off(seen) <= most

    def is_cause_of(self, other: Announced, seen: Sequence[SeenOutage], step: pd.Timedelta) -> bool:
        """Whether two messages of different names speak of one outage.

        Their onsets may be the same; or both explain an outage that was seen, and one was first
        announced when it had begun. What was announced beforehand for different times is two. An
        outage that is sure stands for itself: neither another one that is sure, nor what was said
        beforehand after it, is a message of it.
        """
        if other.sure and (self.sure or self.first_issued < self.earliest):
            return False
        if self.earliest < other.latest + step and other.earliest < self.latest + step:
            return True
        later = max(self.first_issued, other.first_issued)
        return any(
            one.start <= later and self.explains(one, step) and other.explains(one, step)
            for one in seen
        )


@dataclass(frozen=True, eq=False)
class Lasting:
    """How long the present outage lasts: likelihoods of its lengths, and what to say of them."""

    duration: Floats
    words: str


@dataclass(frozen=True, eq=False)
class OutageOutlook:
    """Beliefs of outages at the steps of a time grid.

    Of every announced outage the last message issued by the step counts, whatever its name (of
    several at the same time the narrowest): the warning is the belief, and no filter stands behind
    it. What was seen is certain: an outage that came is no
    longer waited for, and its length is longer than it has lasted.

    Examples
    --------
    >>> noon = pd.Timestamp("2022-07-19T12:00Z")
    >>> lasts = {"probability": 0.7, "duration_p50_h": 2.0}
    >>> warned = OutageWarning(noon - 6 * HOUR, onset_likely=noon, **lasts)
    >>> outlook = OutageOutlook([warned], OutageStatistics(saifi_per_year=0.0), 1.0)
    >>> outlook.at(noon - 2 * HOUR, 5, []).out_probability.round(3)
    array([0. , 0. , 0.7, 0.7, 0. ])
    """

    #: All messages, in any order; those that are not issued yet change nothing.
    warnings: Sequence[OutageWarning]
    statistics: OutageStatistics  #: outages without a warning
    step_h: float  #: length of a step in h

    def at(self, now: pd.Timestamp, n_steps: int, seen: Sequence[SeenOutage]) -> OutageBelief:
        """The belief at a step.

        It looks ``n_steps`` ahead, the present one included. The last outage that was ``seen``
        lasts if the present step is one of it.
        """
        lasting = _lasting_of(seen)
        step = pd.Timedelta(hours=self.step_h)
        elapsed = round((now - lasting.start) / step) if lasting else 0
        announced = self.expected(now, seen)
        # The present outage may be longer than all that lies ahead.
        length = min(elapsed + n_steps + 1, LONGEST_STEPS)
        explained = [self._explanation(announced, one) for one in seen]
        waited_for = [one for one in announced if not any(one is known for known in explained)]
        words = [one.words for one in announced if one.words]
        onset = [self._onset_probability(one, now, n_steps) for one in waited_for]
        kinds = [self._length(one, one.likely, length) for one in waited_for]
        kind = 0
        if lasting:
            # The present one comes first: those behind it are still waited for.
            kind = 1
            present = self._lasting(explained[-1], lasting, now, length)
            others = [one for one in announced if one is not explained[-1]]
            present = self._with_others(present, others, lasting, now)
            onset.insert(0, np.zeros(n_steps))
            kinds.insert(0, present.duration)
            words += [present.words] if present.words else []
        kinds.insert(0, self._unannounced(length))
        return OutageBelief(
            np.array(onset).reshape(len(onset), n_steps),
            np.array(kinds),
            hazard=float(-np.expm1(-self._rates.hazard_per_h * self.step_h)),
            out=bool(lasting),
            kind=kind,
            elapsed=min(elapsed, length - 1),
            words="; ".join(words),
        )

    @property
    def _rates(self) -> Statistics:
        return Statistics.of(self.statistics)

    def _unannounced(self, length: int) -> Floats:
        rates = self._rates
        return durations.lognormal(rates.median_h, rates.sigma, self.step_h, length)

    def expected(self, now: pd.Timestamp, seen: Sequence[SeenOutage]) -> list[Announced]:
        """Outages that are announced by now, by their likely onset.

        Messages of one cause are one outage; the one that was spoken of last names it.
        """
        lasting = _lasting_of(seen)
        step = pd.Timedelta(hours=self.step_h)
        messages = self._messages(now)
        named = {
            name: one for name, group in messages.items() if (one := announced_by(group, lasting))
        }
        last_first = sorted(
            named,
            key=lambda name: (-messages[name][-1].issued_at.value, named[name].spread_h),
        )
        causes: dict[str, list[str]] = {}
        for name in last_first:
            cause = next(
                (one for one in causes if named[one].is_cause_of(named[name], seen, step)), name
            )
            causes.setdefault(cause, []).append(name)
        found = []
        for names in causes.values():
            # Of those issued at one time the one that names the outage is read last.
            joined = [one for name in reversed(names) for one in messages[name]]
            joined.sort(key=lambda one: one.issued_at)
            one = announced_by(joined, lasting)
            assert one  # no all-clear is among them
            found.append(replace(one, dropped=tuple(names[1:])))
        return sorted(found, key=lambda one: one.likely)

    def _messages(self, now: pd.Timestamp) -> dict[str, list[OutageWarning]]:
        """Messages by now that no all-clear took back, by name, in the order of their issue."""
        found: dict[str, list[OutageWarning]] = {}
        for warning in sorted(self.warnings, key=lambda one: one.issued_at):
            if warning.issued_at > now:
                break
            if warning.all_clear:
                found.pop(warning.outage, None)
            else:
                found.setdefault(warning.outage, []).append(completed(warning))
        return found

    def _explanation(self, announced: Sequence[Announced], seen: SeenOutage) -> Announced | None:
        """The announced outage that one that was seen is: of those that explain it the nearest."""
        step = pd.Timedelta(hours=self.step_h)
        able = [one for one in announced if one.explains(seen, step)]
        return min(able, key=lambda one: one.off(seen), default=None)

    def _with_others(
        self, present: Lasting, others: Sequence[Announced], seen: SeenOutage, now: pd.Timestamp
    ) -> Lasting:
        """Length of the time without grid: all outages that have begun for sure must end."""
        step = pd.Timedelta(hours=self.step_h)
        length = len(present.duration)
        elapsed = min(round((now - seen.start) / step), length - 1)
        laws = []
        for one in others:
            if one.sure and one.likely <= now:
                since = np.arange(length) - round((one.likely - seen.start) / step)
                own = self._length(one, one.likely, length).cumsum()
                law = np.where(since < 0, 0.0, own[np.clip(since, 0, length - 1)])
                over = elapsed > 0 and law[elapsed - 1] >= 1.0 - BEYOND
                laws += [] if over else [law]
        if not laws:
            return present
        if not present.words:  # what it was taken for is not outlasted
            laws.append(present.duration.cumsum() / present.duration.sum())
        return Lasting(np.diff(np.prod(laws, axis=0), prepend=0.0), "")

    def _onset_probability(self, one: Announced, now: pd.Timestamp, n_steps: int) -> Floats:
        """Probability that it begins at each step, given that it has not so far."""
        begun = self._begun_probability(one, now, n_steps)
        p = one.message.chance
        left = 1.0 - p * begun[1]
        onset = np.zeros(n_steps)
        # What should have begun by now has not.
        if left > 1e-12:
            onset[1:] = p * np.diff(begun)[1:] / left
        return onset

    def _begun_probability(self, one: Announced, now: pd.Timestamp, n_steps: int) -> Floats:
        """Probability that it begins before each step if it comes, (T + 1,)."""
        steps = np.arange(n_steps + 1)
        if one.shares:
            # A step is out if the outage touches it.
            return one.shares.begun(steps * self.step_h + (now - one.shares.start) / HOUR)
        hours = [(time - now) / HOUR for time in (one.earliest, one.likely, one.latest)]
        # Step k is the one that begins nearest.
        return _triangular(np.asarray((steps - 0.5) * self.step_h), *hours)

    def _lasting(
        self, known: Announced | None, seen: SeenOutage, now: pd.Timestamp, length: int
    ) -> Lasting:
        """How long the present outage lasts, by all that was said of its end and what was not."""
        step = pd.Timedelta(hours=self.step_h)
        elapsed = round((now - seen.start) / step)
        duration = self._unannounced(length)
        not_before = seen.start
        words = ""
        notices: tuple[OutageWarning, ...] = ()
        if known:
            notices = known.notices
            not_before = known.not_before or seen.start
            least = min(max(elapsed, round((not_before - seen.start) / step)), length - 1)
            said = self._length(known, seen.start, length)
            if known.message.says_length and said[least:].sum() <= BEYOND:
                # Longer than any message said: only the statistics are left.
                words = f"{_named(known.message.outage)} is outlasted, the statistics count"
            else:
                duration = said
        duration = restoration.not_before(duration, (not_before - seen.start) / step)
        ends_h = self.step_h * np.arange(1.0, length + 1.0)
        told = [
            ((one.issued_at - seen.start) / HOUR, (one.restored_by - seen.start) / HOUR)
            for one in notices
            if one.restored_by and one.restored_by > seen.start
        ]
        now_h = self.step_h * elapsed
        likely = self._rates.notices.likelihood(ends_h, now_h, told, self.step_h)
        return Lasting(duration * (likely / likely.max()), words)

    def _length(self, one: Announced, begun: pd.Timestamp, length: int) -> Floats:
        """Lengths of an outage that began at a time, as messages say it, else the statistics."""
        message = one.message
        if message.restored_likely:
            least_h = 0.5 * self.step_h
            hours = max((message.restored_likely - begun) / HOUR, least_h)
            message = replace(message, restored_likely=None, duration_p50_h=hours)
        spread = message.duration_p10_h or message.duration_p90_h or message.length
        if one.estimate and message.duration_p50_h and not spread:
            low, middle, high = (message.duration_p50_h * each for each in self._rates.estimate)
            message = replace(
                message, duration_p10_h=low, duration_p50_h=middle, duration_p90_h=high
            )
        found = length_of(message, self.step_h, length)
        return self._unannounced(length) if found is None else found


def length_of(message: OutageWarning, step_h: float, length: int) -> Floats | None:
    """Probability of each number of steps that a message says it lasts; None if it says nothing."""
    if message.length:
        return durations.of_length(message.length, step_h, length)
    low_h, median_h, high_h = message.duration_p10_h, message.duration_p50_h, message.duration_p90_h
    if not median_h:
        return None
    if not (low_h or high_h):
        return durations.known(median_h, step_h, length)
    # One side alone speaks for both.
    below_h = low_h or median_h**2 / (high_h or median_h)
    above_h = high_h or median_h**2 / (low_h or median_h)
    return durations.between_quantiles(below_h, median_h, above_h, step_h, length)


def said_so_far(
    messages: Sequence[OutageWarning], times: pd.DatetimeIndex
) -> tuple[Announced, Floats] | None:
    """Outage that messages announce, and the probability of its onset in each step if it comes.

    Messages stand in the order of their issue.

    Returns
    -------
    Announced, array of shape (T,), or None
        The outage, and the probability of each step to be the one in which it begins; None after
        the all-clear, or where none says when it begins.
    """
    found = announced_by([completed(one) for one in messages], None)
    if not found:
        return None
    step_h = (times[1] - times[0]) / HOUR
    outlook = OutageOutlook(messages, OutageStatistics("none"), step_h)
    return found, np.diff(outlook._begun_probability(found, times[0], len(times)))


def seen_outages(times: pd.DatetimeIndex, out: Sequence[bool]) -> list[SeenOutage]:
    """Outages among the steps so far, of which the last is the present one.

    >>> hours = pd.date_range("2022-07-19T12:00Z", periods=3, freq="h")
    >>> [one.lasts for one in seen_outages(hours, [True, False, True])]
    [False, True]
    """
    found: list[SeenOutage] = []
    for time, dark in zip(times, out, strict=False):
        lasts = bool(found) and found[-1].lasts
        if dark and not lasts:
            found.append(SeenOutage(time))
        elif lasts and not dark:
            found[-1] = replace(found[-1], end=time)
    return found


def _lasting_of(seen: Sequence[SeenOutage]) -> SeenOutage | None:
    """The present outage: the last one that was seen, if it is not over."""
    return seen[-1] if seen and seen[-1].lasts else None


def announced_by(
    messages: Sequence[OutageWarning], lasting: SeenOutage | None = None
) -> Announced | None:
    """The outage that messages speak of, in their order; None after the all-clear.

    What the last message leaves out stands as the one before said it. A message without any onset
    that comes during an outage, or an hour before it was seen, speaks of that one.

    Presets of the messages are filled in; ``lasting`` is the present outage.
    """
    last = messages[-1]
    if last.all_clear:
        return None
    since = max((i for i, m in enumerate(messages) if m.all_clear), default=-1) + 1
    timed = [m for m in messages[since:] if m.onset_likely]
    lengths = [m for m in messages[since:] if m.says_length]
    said = lengths[-1] if lengths else None
    if said and not last.says_length:
        last = replace(
            last,
            duration_p10_h=said.duration_p10_h,
            duration_p50_h=said.duration_p50_h,
            duration_p90_h=said.duration_p90_h,
            restored_likely=said.restored_likely,
            length=said.length,
        )
    not_before = [m for m in messages[since:] if m.restored_not_before]
    stands = bool(not_before) and (not said or not_before[-1].issued_at >= said.issued_at)
    if timed:
        onset = timed[-1]
    elif lasting and last.issued_at >= lasting.start - HOUR:
        onset = replace(last, onset_likely=lasting.start)
    else:
        return None
    likely = onset.onset_likely
    assert likely
    return Announced(
        message=last,
        first_issued=messages[since].issued_at,
        earliest=onset.onset_earliest or likely,
        likely=likely,
        latest=onset.onset_latest or likely,
        shares=onset.onset,
        estimate=any(not m.onset_likely or m.issued_at >= m.onset_likely for m in lengths[-1:]),
        not_before=not_before[-1].restored_not_before if stands else None,
        notices=tuple(m for m in messages[since:] if m.restored_by),
    )


def _named(outage: str) -> str:
    """The name of an outage, for people."""
    return outage or "the unnamed outage"


def _triangular(hours: Floats, earliest: float, likely: float, latest: float) -> Floats:
    """Probability that a triangular time comes before some hours; a jump where it is known."""
    if latest <= earliest:
        return np.asarray((hours >= likely).astype(float))
    wide = latest - earliest
    rises = np.clip(hours, earliest, likely) - earliest
    falls = latest - np.clip(hours, likely, latest)
    below = rises**2 / (wide * (likely - earliest)) if likely > earliest else 0.0
    above = falls**2 / (wide * (latest - likely)) if latest > likely else 0.0
    return np.where(hours < likely, below, np.where(hours < latest, 1.0 - above, 1.0))
