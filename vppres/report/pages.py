"""HTML pages that need nothing beside them."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from vppres.core.errors import InputError, StorageError
from vppres.io.atomic import atomic_write_bytes, full_disk, is_full


def page(template: str, content: Mapping[str, Any]) -> str:
    """A template of the package, filled; a name that the content lacks is an error."""
    return _environment().get_template(template).render(content)


@cache
def _environment() -> Environment:
    """The templates of the package; each is compiled once."""
    return Environment(
        loader=PackageLoader("vppres.report"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )


def write_page(file: Path, content: str | bytes) -> None:
    """Write a page, whole or not at all; its folder is made if missing."""
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        atomic_write_bytes(file, content.encode() if isinstance(content, str) else content)
    except OSError as error:
        if is_full(error):
            raise StorageError(full_disk(str(file), file.exists())) from error
        raise InputError.of(
            str(file),
            f"cannot be written ({error.strerror})",
            "Choose another file, or check its permissions.",
        ) from error
