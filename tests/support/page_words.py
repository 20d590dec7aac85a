"""Words of the page, by node."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

NODE = shutil.which("node")
WORDS = Path(__file__).parents[2] / "vppres" / "service" / "page" / "words.js"


def said_by(script: str, folder: Path, given: str = "") -> Any:
    """Output of a script beside the page's words, with its input."""
    (folder / "words.mjs").write_text(WORDS.read_text(encoding="utf-8"), encoding="utf-8")
    (folder / "say.mjs").write_text(script, encoding="utf-8")
    asked = [str(NODE), str(folder / "say.mjs")]
    done = subprocess.run(asked, input=given, capture_output=True, text=True, check=True)
    return json.loads(done.stdout)


FIRST_LINES = """
import { SiteClock, announced, announcesNothing, attention, facts, verdict, why } from "./words.mjs";
import { readFileSync } from "node:fs";
const view = JSON.parse(readFileSync(0));
view.clock = new SiteClock("UTC");
view.now = new Date(view.overview.now);
const { off, status } = view.overview.plan;
const reasons = (off ?? []).map((one) => why(one, null, status).words);
const events = Object.values(view.overview.events).map((event) => announced(event, view));
console.log(JSON.stringify({ verdict: verdict(view), facts: facts(view), attention: attention(view), announced: announcesNothing(view), reasons, events }));
"""


def first_lines(site: Any, overview: Any, folder: Path) -> dict[str, Any]:
    """What the page says first: its verdict, facts, warnings, why customers are off, and events."""
    view = json.dumps({"site": site, "overview": overview, "lost": False})
    found: dict[str, Any] = said_by(FIRST_LINES, folder, view)
    return found
