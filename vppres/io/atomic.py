"""Files and folders that are whole or absent: written aside, then renamed.

What is written is in a hidden folder beside the target, ``.NAME.DIGITS.vppres-part``. It is locked
(``flock``) as long as its process lives, so that the next run can tell what a killed one left and
remove it. What takes a name is on the disk before (``fsync``).
"""

from __future__ import annotations

import errno
import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from uuid import uuid4

from vppres.core.errors import InputError, Problem, StorageError

if sys.platform != "win32":
    import fcntl

RUN_MARK = "summary.json"
_PART = ".vppres-part"
_NEW = "new"  # in the hidden folder: what is being written,
_OLD = "old"  # and an older run that is being replaced
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


@contextmanager
def atomic_folder(target: str | Path) -> Iterator[Path]:
    """A temporary folder that becomes ``target``, a link followed, when the block succeeds.

    Whatever ends the block early, an interrupt included, leaves the target as it was. An older run
    (a folder with ``summary.json``) is replaced by two renames; if the process is killed between
    them, the next one puts the old folder back. A target that holds something other than a run, or
    cannot be written, is an InputError before the block runs; a full disk is a StorageError.
    """
    given = str(target)
    target = check_target(target)
    with ExitStack() as stack:
        try:
            # A folder that is being written and is gone, since its command ended, stays gone.
            if target.parent.parent.suffix != _PART:
                target.parent.mkdir(parents=True, exist_ok=True)
            hidden = stack.enter_context(_hidden_folder(target))
            new = hidden / _NEW
            new.mkdir()
        except OSError as error:
            raise InputError(_unwritable(given, error)) from error
        try:
            yield new
            for path in sorted(new.rglob("*")):
                if not path.is_symlink():
                    _settle(path)
            _settle(new)
            _replace_folder(target, hidden)
            _settle(target.parent)
        except OSError as error:
            if is_full(error):
                raise StorageError(full_disk(given, target.exists())) from error
            raise


@contextmanager
def scratch_folder() -> Iterator[Path]:
    """An empty folder for a moment, this user's alone; those of killed runs are removed."""
    with _hidden_folder(Path(tempfile.gettempdir()) / "scratch") as hidden:
        hidden.chmod(0o700)
        yield hidden


def atomic_write_text(path: str | Path, text: str) -> None:
    """Write a UTF-8 text file so that a reader sees the old or the new text, never a part."""
    atomic_write_bytes(path, text.encode("utf-8"))


def atomic_write_bytes(path: str | Path, content: bytes) -> None:
    """Write a file so that a reader sees the old or the new content, never a part."""
    path = Path(path).absolute()
    with _hidden_folder(path) as hidden:
        (hidden / _NEW).write_bytes(content)
        _settle(hidden / _NEW)
        os.replace(hidden / _NEW, path)
        _settle(path.parent)


def check_target(target: str | Path) -> Path:
    """The folder that will be written, a link followed; refused where something else is than a run.

    That is a file, a link to nothing or to something that is not a run, a folder that is neither
    empty nor a run's, or a place that cannot be written.
    """
    given = str(target)
    target = Path(target).absolute()
    try:
        target.lstat()
    except FileNotFoundError:
        pass
    except OSError as error:
        raise InputError(_unwritable(given, error)) from error
    link = target.is_symlink()
    if link and not target.exists():
        raise InputError.of(
            given, "is a symbolic link that leads nowhere", "Remove it, or choose another name."
        )
    real = Path(os.path.realpath(target)) if link else target
    if real.is_dir():
        if not (real / RUN_MARK).is_file() and any(real.iterdir()):
            what = f"links to {real}, which is not" if link else "exists and is not"
            raise InputError.of(
                given,
                f"{what} a run folder (it has no {RUN_MARK})",
                "Choose another folder, or remove this one.",
            )
    elif real.exists():
        raise InputError.of(given, "exists and is not a folder", "Choose another name.")
    _check_place(given, real)
    return real


def check_file(target: str | Path, ending: str = "") -> Path:
    """Refuse a file that cannot be written, before the work: a folder, a link, or such a place.

    With an ``ending``, as ``.html``, also a name that promises another format.
    """
    given = str(target)
    target = Path(target).absolute()
    if not target.name.lower().endswith(ending):
        cure = f"Give a name that ends in {ending}."
        raise InputError.of(given, f"does not end in {ending}, the format of the file", cure)
    if target.is_symlink():
        raise InputError.of(
            given, "is a symbolic link", "Name the file itself, or choose another name."
        )
    if target.exists() and not target.is_file():
        raise InputError.of(given, "exists and is not a file", "Choose another name.")
    _check_place(given, target)
    return target


def remove_leftovers(folder: Path) -> None:
    """Remove what killed runs left in a folder, and put back what one of them was replacing.

    Only names that this module makes, and only if no process holds the lock. What cannot be
    removed is left.
    """
    with suppress(OSError):
        for hidden in folder.glob(f".*{_PART}"):
            _remove_if_abandoned(hidden)


def is_full(error: OSError) -> bool:
    """Whether an error means that the disk takes no more: full, a quota, or a limit of size."""
    return error.errno in _FULL


def full_disk(target: str, older: bool) -> str:
    """Message for a full disk, with its cure."""
    kept = "what was there before is kept" if older else "nothing was written"
    return (
        f"{target}: the disk is full, or a quota is reached; {kept}. Free some space, or write "
        "to another disk."
    )


def _check_place(given: str, target: Path) -> None:
    """Whether the nearest folder above the target can be written."""
    place = next(folder for folder in target.parents if folder.exists())
    code = 0 if os.access(place, os.W_OK | os.X_OK) else errno.EACCES
    code = code if place.is_dir() else errno.ENOTDIR
    if code:
        raise InputError(_unwritable(given, OSError(code, os.strerror(code))))


@contextmanager
def _hidden_folder(target: Path) -> Iterator[Path]:
    """A hidden folder beside the target, locked for the block and removed after it."""
    remove_leftovers(target.parent)
    hidden, descriptor = _locked_folder(target)
    try:
        yield hidden
    finally:
        # Processes of a command that ends may still write to the name; they find nothing there.
        with suppress(OSError):
            hidden = hidden.rename(_hidden_name(target))
        for _ in range(2):  # the second takes what was being made under the old name meanwhile
            shutil.rmtree(hidden, ignore_errors=True)
        os.close(descriptor)


def _hidden_name(target: Path) -> Path:
    """A name in the folder of the target: a rename is atomic only within one file system."""
    return target.with_name(f".{target.name}.{uuid4().hex[:8]}{_PART}")


def _locked_folder(target: Path) -> tuple[Path, int]:
    """A new hidden folder, and the descriptor that holds its lock."""
    while True:
        hidden = _hidden_name(target)
        hidden.mkdir()
        with suppress(FileNotFoundError):
            descriptor = os.open(hidden, os.O_RDONLY)
            # Before the lock another run may have taken it for a leftover and removed it.
            if _lock(descriptor) and hidden.exists():
                return hidden, descriptor
            os.close(descriptor)


def _lock(descriptor: int) -> bool:
    """Lock an open folder until it is closed; False if another process has done so.

    Where there are no locks (some network drives), others cannot lock it either, and keep off.
    """
    if sys.platform != "win32":
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            return error.errno not in (errno.EWOULDBLOCK, errno.EACCES)
    return True


def _remove_if_abandoned(hidden: Path) -> None:
    """Remove a hidden folder of this user whose process is dead; its older run is put back."""
    if sys.platform == "win32":
        return
    with suppress(OSError), ExitStack() as stack:
        descriptor = os.open(hidden, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
        stack.callback(os.close, descriptor)
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if os.fstat(descriptor).st_uid != os.getuid():
            return
        target = hidden.with_name(hidden.name[1:].rsplit(".", 2)[0])
        if (hidden / _OLD).is_dir() and not target.exists():
            (hidden / _OLD).rename(target)
        shutil.rmtree(hidden, ignore_errors=True)


def _replace_folder(target: Path, hidden: Path) -> None:
    """Give the target's name to the new folder, and what bore it to the hidden one."""
    if not target.is_dir() or not any(target.iterdir()):
        os.replace(hidden / _NEW, target)
        return
    # The block may have been long: what is in the target now decides, not what was before.
    check_target(target)
    try:
        os.rename(target, hidden / _OLD)
        os.rename(hidden / _NEW, target)
    except BaseException:
        if not target.exists():
            os.rename(hidden / _OLD, target)
        raise


def _settle(path: Path) -> None:
    """Bring a file, or the names in a folder, onto the disk.

    Some network drives do not know what to do with a folder, and Windows opens none.
    """
    if sys.platform == "win32" and path.is_dir():
        return
    descriptor = os.open(path, os.O_RDWR if sys.platform == "win32" else os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):
            raise
    finally:
        os.close(descriptor)


def _unwritable(given: str, error: OSError) -> Problem:
    return Problem(
        given,
        f"cannot be written ({error.strerror})",
        "Choose another folder, or check its permissions.",
    )
