"""One adapter for each public feed: where it is, under which licence, and how it is read."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from vppres.core.errors import InputError
from vppres.feeds.incidents import FeedSnapshot, Incident, time_in
from vppres.io.messages import did_you_mean

Row = Mapping[str, Any]


@dataclass(frozen=True)
class PublicFeed:
    """A public feed."""

    name: str  #: short name
    operator: str  #: network operator
    url: str  #: what is asked
    licence: str  #: licence of the data, which asks for attribution
    suffix: str  #: of recorded answers
    read: Callable[[bytes], FeedSnapshot]  #: reads an answer


def read_ukpn(content: bytes) -> FeedSnapshot:
    """Live faults of UK Power Networks: a list of records, or a page with ``results``."""
    found = _json("ukpn", content)
    rows = found.get("results") if isinstance(found, dict) else found
    return _snapshot("ukpn", rows, _of_ukpn)


def _of_ukpn(row: Row) -> Incident:
    kind = str(row.get("powercuttype") or "")
    full = str(row.get("fullpostcodedata") or row.get("postcodesaffected") or "")
    return Incident(
        _name(row["incidentreference"]),
        _parts(full, ";"),
        planned=kind == "Planned",
        start=time_in(row.get("planneddate") or row.get("receiveddate")),
        end=time_in(row.get("estimatedrestorationdate")),
        restored=kind == "Restored" or bool(row.get("restoreddatetime")),
    )


def read_ssen(content: bytes) -> FeedSnapshot:
    """Faults of Scottish and Southern Electricity Networks."""
    found = _json("ssen", content)
    if not isinstance(found, dict):
        raise _unreadable("ssen", "is no object with faults")
    return _snapshot("ssen", found.get("faults"), _of_ssen, found.get("timestampUtc"))


def _of_ssen(row: Row) -> Incident:
    # Planned work has the type PSI, and no beginning but that of its record.
    merged = bool(row.get("mergedTo"))
    return Incident(
        _name(row["reference"]),
        tuple(str(one) for one in row.get("affectedAreas") or ()),
        start=time_in(row.get("loggedAtUtc")),
        end=time_in(row.get("estimatedRestorationTimeUtc")),
        restored=merged,
    )


def read_nged(content: bytes) -> FeedSnapshot:
    """Live power cuts of National Grid Electricity Distribution, a CSV file."""
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise _unreadable("nged", "is no text") from error
    table = csv.DictReader(io.StringIO(text))
    try:
        if "Incident ID" not in (table.fieldnames or ()):
            # A denial comes with the status of success.
            raise _unreadable("nged", "has no column Incident ID")
        rows = list(table)
    except csv.Error as error:
        raise _unreadable("nged", "is no CSV file") from error
    made = [str(row.get("Upload Date") or "") for row in rows]
    return _snapshot("nged", rows, _of_nged, max(made, default=None))


def _of_nged(row: Row) -> Incident:
    return Incident(
        _name(row["Incident ID"]),
        _parts(str(row.get("Postcodes") or ""), ","),
        planned=str(row.get("Planned")).lower() == "true",
        start=time_in(row.get("Start Time")),
        end=time_in(row.get("ETR")),
        restored=str(row.get("Status")) == "Restored",
    )


FEEDS = {
    feed.name: feed
    for feed in (
        PublicFeed(
            "ukpn",
            "UK Power Networks",
            "https://ukpowernetworks.opendatasoft.com/api/explore/v2.1/catalog/datasets/"
            "ukpn-live-faults/exports/json",
            "CC BY 4.0",
            ".json",
            read_ukpn,
        ),
        PublicFeed(
            "ssen",
            "Scottish and Southern Electricity Networks",
            "https://external.distribution.prd.ssen.co.uk/opendataportal-prd/v4/api/getallfaults",
            "CC BY 4.0",
            ".json",
            read_ssen,
        ),
        PublicFeed(
            "nged",
            "National Grid Electricity Distribution",
            "https://connecteddata.nationalgrid.co.uk/dataset/"
            "d6672e1e-c684-4cea-bb78-c7e5248b62a2/resource/"
            "292f788f-4339-455b-8cc0-153e14509d4d/download/power_outage_ext.csv",
            "NGED Open Data Licence",
            ".csv",
            read_nged,
        ),
    )
}


def feed_named(name: str) -> PublicFeed:
    """A feed by its name.

    Raises
    ------
    InputError
        If there is none.
    """
    if name not in FEEDS:
        raise InputError.of(
            "options",
            "is not a feed",
            did_you_mean(name, FEEDS, "Correct the feed."),
            field="feed",
            value=name,
        )
    return FEEDS[name]


def _snapshot(
    feed: str, rows: Any, incident: Callable[[Row], Incident], made_at: str | None = None
) -> FeedSnapshot:
    """The rows that can be read; an answer of which none can is refused."""
    if not isinstance(rows, list):
        raise _unreadable(feed, "has no list of incidents")
    found = [one for row in rows if (one := _read(row, incident)) is not None]
    if rows and not found:
        raise _unreadable(feed, "has no row that can be read")
    try:
        made = time_in(made_at)
    except ValueError:
        made = None
    return FeedSnapshot(tuple(_merged_rows(found)), made, len(rows) - len(found))


def _read(row: Any, incident: Callable[[Row], Incident]) -> Incident | None:
    """An incident; None where the row is none."""
    try:
        return incident(row)
    except (AttributeError, KeyError, TypeError, ValueError, OverflowError):
        return None


def _merged_rows(incidents: Iterable[Incident]) -> list[Incident]:
    """Rows of one reference as one incident, with the postcodes of all and the latest end."""
    rows: dict[str, list[Incident]] = {}
    for one in incidents:
        rows.setdefault(one.name, []).append(one)
    return [_joined(each) for each in rows.values()]


def _joined(rows: Sequence[Incident]) -> Incident:
    """The rows of one reference that are not restored, or the last one if all are."""
    last = [one for one in rows if not one.restored] or rows[-1:]
    return replace(
        last[0],
        postcodes=tuple(postcode for one in last for postcode in one.postcodes),
        planned=all(one.planned for one in last),
        end=max((one.end for one in last if one.end is not None), default=None),
    )


def _json(feed: str, content: bytes) -> Any:
    try:
        return json.loads(content)
    except (ValueError, RecursionError) as error:
        raise _unreadable(feed, "is no JSON") from error


def _unreadable(feed: str, message: str) -> InputError:
    cure = "What was said before stays; the feed is asked again."
    return InputError.of(f"feed {feed}", message, cure)


def _name(value: Any) -> str:
    """A reference that can be the name of an event."""
    text = str(value or "").strip()
    if not text or len(text) > 80 or not text.isprintable():
        raise ValueError("no reference")
    return text


def _parts(text: str, separator: str) -> tuple[str, ...]:
    return tuple(part.strip() for part in text.split(separator) if part.strip())
