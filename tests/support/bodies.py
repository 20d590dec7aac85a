"""Bodies of telemetry that are large and wrong."""

from __future__ import annotations

import json
from typing import Any

BEGIN = "2026-11-21T12:00:00Z"


def reading(**fields: Any) -> dict[str, Any]:
    one = {"source": "scada", "asset": "big", "quantity": "soc", "start": BEGIN,
           "resolution": "PT1H", "values": [0.5]}  # fmt: skip
    return {"series": [{**one, **fields}]}


def crowd() -> bytes:
    """8 MB of readings that are none: 2.6 million mistakes."""
    one = json.dumps(reading(values=[""] * 1280)["series"][0], separators=(",", ":"))
    return f'{{"series":[{",".join([one] * 2000)}]}}'.encode()


def strangers() -> bytes:
    """8 MB of fields that there are not."""
    fields = ",".join(f'"{i:x}":0' for i in range(780_000))
    return f'{{"series":[{{{fields}}}]}}'.encode()
