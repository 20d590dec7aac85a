"""JSON Schema of scenario.toml, for editors that complete and check TOML files."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from pydantic.json_schema import JsonSchemaValue, models_json_schema

from vppres.io.atomic import atomic_write_text
from vppres.io.schema import TABLES, ScenarioFile
from vppres.io.settings import SCENARIO_FILE

SCHEMA_FILE = "scenario.schema.json"
DIRECTIVE = f"#:schema ./{SCHEMA_FILE}\n"
"""First line of a scenario.toml, as taplo and the editors built on it read it."""


def editor_schema() -> dict[str, Any]:
    """The schema, with every unit in the description that an editor shows.

    >>> editor_schema()["$defs"]["TimeSection"]["properties"]["step_minutes"]["description"]
    'length of a step (min)'
    """
    schema = ScenarioFile.model_json_schema()
    for table in (schema, *schema["$defs"].values()):
        for field in table["properties"].values():
            if "unit" in field:
                field["description"] += f" ({field['unit']})"
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}


def json_schema() -> JsonSchemaValue:
    """JSON Schema of scenario.toml (`ScenarioFile`) and of one row of each table."""
    return models_json_schema(
        [(model, "validation") for model in TABLES.values()], title="vppres scenario"
    )[1]


def schema_text() -> str:
    """The schema as JSON."""
    return json.dumps(editor_schema(), indent=2, ensure_ascii=False) + "\n"


def add_editor_schema(folder: Path) -> None:
    """Write the schema beside scenario.toml, and the line that points to it into scenario.toml."""
    atomic_write_text(folder / SCHEMA_FILE, schema_text())
    settings = folder / SCENARIO_FILE
    atomic_write_text(settings, DIRECTIVE + "\n" + settings.read_text(encoding="utf-8"))
