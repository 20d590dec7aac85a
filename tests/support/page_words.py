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
