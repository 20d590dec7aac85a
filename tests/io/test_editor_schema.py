"""The JSON Schema that editors read: it takes what the reader takes and refuses what it refuses."""

from __future__ import annotations

import json
import tomllib
from datetime import datetime
from typing import Any

import jsonschema
import pytest

from tests.support.tiny_day import tiny_scenario
from vppres.io import find_scenario, packaged_scenarios
from vppres.io.editor import editor_schema, schema_text
from vppres.io.scenario_writer import document_of


def as_json(document: dict[str, Any]) -> Any:
    """A document as an editor hands it to its validator: times as text."""
    return json.loads(json.dumps(document, default=datetime.isoformat))


def mistakes(document: dict[str, Any]) -> list[str]:
    """Where the schema finds something wrong."""
    validator = jsonschema.Draft202012Validator(editor_schema())
    return [
        ".".join(map(str, error.absolute_path))
        for error in validator.iter_errors(as_json(document))
    ]


def test_schema_is_a_schema() -> None:
    jsonschema.Draft202012Validator.check_schema(json.loads(schema_text()))


@pytest.mark.parametrize("name", packaged_scenarios())
def test_packaged_scenarios_pass(name: str) -> None:
    text = (find_scenario(name) / "scenario.toml").read_text(encoding="utf-8")
    assert mistakes(tomllib.loads(text)) == []


@pytest.mark.parametrize(
    ("section", "key", "value", "where"),
    [
        ("network", "slack_bus", "busbar", None),  # names and numbers are both buses
        ("network", "v_min_pu", -1.0, "network.v_min_pu"),
        ("time", "steps", 2.5, "time.steps"),
        ("controller", "kind", "pid", "controller.kind"),
        ("controller", "horizon", 5, "controller"),
        ("files", "lines", "../lines.csv", "files.lines"),
    ],
)
def test_mistakes_are_found_where_they_are(
    section: str, key: str, value: object, where: str | None
) -> None:
    document = document_of(tiny_scenario())
    document.setdefault(section, {})[key] = value
    assert mistakes(document) == ([] if where is None else [where])
