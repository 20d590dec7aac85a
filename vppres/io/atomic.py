"""Files and folders that are whole or absent: written aside, then renamed."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from uuid import uuid4

from vppres.core.errors import InputError, Problem

RUN_MARK = "summary.json"


@contextmanager
def atomic_folder(target: str | Path) -> Iterator[Path]:
    """A temporary folder beside ``target`` that takes its name when the block succeeds.

    Whatever ends the block early, an interrupt included, leaves the target as it was. An older run
    (a folder with ``summary.json``) is replaced.

    Parameters
    ----------
    target : str or Path
        The folder to be.

    Yields
    ------
    Path
        An empty folder to write into.

    Raises
    ------
    InputError
        Before the block runs, if the target holds something other than a run.
    """
    target = Path(target).absolute()
    check_target(target)
    aside = _sibling(target)
    try:
        aside.mkdir(parents=True)
    except OSError as error:
        raise InputError(_unwritable(target, error)) from error
    try:
        yield aside
        _take_name(aside, target)
    finally:
        shutil.rmtree(aside, ignore_errors=True)


def atomic_write_text(path: str | Path, text: str) -> None:
    """Write a UTF-8 text file so that a reader sees the old or the new text, never a part."""
    path = Path(path).absolute()
    aside = _sibling(path)
    try:
        aside.write_text(text, encoding="utf-8", newline="\n")
        os.replace(aside, path)
    finally:
        aside.unlink(missing_ok=True)


def check_target(target: str | Path) -> None:
    """Refuse a target that would destroy something other than an older run.

    Raises
    ------
    InputError
        If the target is a file, or a folder that is not empty and not a run folder.
    """
    target = Path(target)
    if target.is_dir():
        if not (target / RUN_MARK).is_file() and any(target.iterdir()):
            raise InputError(Problem(
                str(target), f"exists and is not a run folder (it has no {RUN_MARK})",
                "Choose another folder, or remove this one."))
    elif target.exists():
        raise InputError(Problem(str(target), "exists and is not a folder",
                                 "Choose another name."))


def _sibling(target: Path) -> Path:
    """A hidden name beside the target: a rename is atomic only within one file system."""
    return target.with_name(f".{target.name}.{uuid4().hex[:8]}.part")


def _take_name(aside: Path, target: Path) -> None:
    if not target.is_dir():
        os.replace(aside, target)
        return
    # The block may have been long: what is in the target now decides, not what was before.
    check_target(target)
    old = _sibling(target)
    os.replace(target, old)
    try:
        os.replace(aside, target)
    except BaseException:
        os.replace(old, target)
        raise
    shutil.rmtree(old)


def _unwritable(target: Path, error: OSError) -> Problem:
    return Problem(str(target), f"cannot be written ({error.strerror})",
                   "Choose another folder, or check its permissions.")
