"""Whole or old, at every kill: files and folders that are written aside and renamed."""

from __future__ import annotations

import errno
import json
import os
import signal
import subprocess
import sys
import textwrap
import threading
from contextlib import suppress
from pathlib import Path

import pytest

from tests.support.refusals import refusal
from vppres.core.errors import InputError, ReportError, StorageError
from vppres.day.options import RunOptions
from vppres.day.simulate import run_day
from vppres.io.atomic import (
    atomic_folder,
    atomic_write_text,
    check_file,
    check_target,
    remove_leftovers,
    scratch_folder,
)
from vppres.report import run_folder
from vppres.report.finished import read_finished
from vppres.report.pages import write_page
from vppres.report.run_folder import write_run
from vppres.scenario.scenario import Scenario
from vppres.studies.sweep import folder_name

KILLS = 15


def filled(target: Path, text: str = "") -> None:
    """Write a run folder with one file."""
    with atomic_folder(target) as aside:
        (aside / "summary.json").write_text(text, encoding="utf-8")


# Replaces a run in a child process that ends itself, as kill -9 would, at the n-th call that Python
# reports of the system (open, mkdir, rename, remove, ...), for n = 0, 1, 2, ... until one is left
# alone. Prints what was there after each, as the next run finds it.
KILLED_AT_EVERY_CALL = textwrap.dedent("""
    import os, sys
    from pathlib import Path
    from vppres.io import atomic

    place = Path(sys.argv[1])
    target = place / "run"

    def content():
        return {f.name: f.read_text() for f in target.iterdir()} if target.exists() else None

    def write(text):
        with atomic.atomic_folder(target) as aside:
            (aside / "summary.json").write_text(text)
            (aside / "steps").write_text(text)

    write("0")
    for n in range(1000):
        child = os.fork()
        if child == 0:
            left = n
            def count(event, arguments):
                global left
                if event.startswith(("open", "os.", "shutil.", "ctypes")):
                    left -= 1
                    if left < 0:
                        os._exit(9)
            sys.addaudithook(count)
            write(str(n + 1))
            os._exit(0)
        status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        at_once = content()
        atomic.remove_leftovers(place)
        found = content()
        names = sorted(p.name for p in place.iterdir())
        print(n, status, at_once is None, sorted(found), set(found.values()), names)
        assert names == ["run"], names
        assert len(found) == 2 and len(set(found.values())) == 1, found
        if status == 0:
            assert set(found.values()) == {str(n + 1)}
            break
    else:
        raise SystemExit("never ended")
""")


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="forks")
def test_a_run_is_whole_or_the_old_one_at_every_kill(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", KILLED_AT_EVERY_CALL, str(tmp_path)],
        text=True,
        capture_output=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    calls = done.stdout.splitlines()
    assert len(calls) > 15
    # Between the two renames there is one moment without the target; the next run ends it.
    assert sum(line.split()[2] == "True" for line in calls) <= 1


@pytest.mark.parametrize("fails", [1, 2])
def test_a_rename_that_fails_leaves_the_old_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fails: int
) -> None:
    target = tmp_path / "run"
    filled(target, "old")
    calls = []
    rename = os.rename

    def failing(old: Path, new: Path) -> None:
        calls.append(new)
        if len(calls) == fails:
            raise OSError(errno.EIO, "broken")
        rename(old, new)

    monkeypatch.setattr("os.rename", failing)
    with pytest.raises(OSError, match="broken"), atomic_folder(target) as aside:
        (aside / "summary.json").write_text("new", encoding="utf-8")
    assert (target / "summary.json").read_text(encoding="utf-8") == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["run"]


def test_only_what_dead_runs_left_is_removed(tmp_path: Path) -> None:
    with atomic_folder(tmp_path / "mine") as alive:
        (tmp_path / ".run.01234567.vppres-part").mkdir()
        half = tmp_path / ".page.html.01234567.vppres-part"
        half.mkdir()
        (half / "new").write_text("half", encoding="utf-8")
        (tmp_path / ".run.01234567.part").mkdir()  # of another program
        (tmp_path / "vppres-part").mkdir()
        elsewhere = tmp_path / "elsewhere"
        elsewhere.mkdir()
        (elsewhere / "precious").touch()
        (tmp_path / ".link.01234567.vppres-part").symlink_to(elsewhere)
        remove_leftovers(tmp_path)
        assert alive.is_dir()
        assert (elsewhere / "precious").exists()
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        ".link.01234567.vppres-part",
        ".run.01234567.part",
        "elsewhere",
        "mine",
        "vppres-part",
    ]


def test_a_folder_goes_although_processes_still_write_into_it(tmp_path: Path) -> None:
    """Those of a sweep may do so for a moment after its end."""

    def write_on(folder: Path) -> None:
        with suppress(FileNotFoundError):
            for number in range(100_000):
                (folder / str(number)).touch()

    for _ in range(10):
        with suppress(KeyboardInterrupt), atomic_folder(tmp_path / "sweep") as aside:
            writer = threading.Thread(target=write_on, args=(aside,))
            writer.start()
            while not any(aside.iterdir()):
                pass
            raise KeyboardInterrupt
        writer.join()
        with pytest.raises(InputError), atomic_folder(aside / "horizon=0"):
            pass
        assert list(tmp_path.iterdir()) == []


def test_scratch_folders_go_and_so_do_those_of_killed_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.gettempdir", lambda: str(tmp_path))
    (tmp_path / ".scratch.01234567.vppres-part").mkdir()
    with scratch_folder() as folder:
        assert list(tmp_path.iterdir()) == [folder]
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("stop", [RuntimeError, KeyboardInterrupt, SystemExit])
def test_a_folder_leaves_nothing_when_stopped(tmp_path: Path, stop: type[BaseException]) -> None:
    with pytest.raises(stop), atomic_folder(tmp_path / "a") as aside:
        (aside / "steps.parquet").write_bytes(b"half")
        raise stop
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_is_no_run_is_refused(tmp_path: Path) -> None:
    target = tmp_path / "thesis"
    target.mkdir()
    (target / "chapter.txt").write_text("precious", encoding="utf-8")
    assert refusal(filled, target) == (
        f"{target}: exists and is not a run folder (it has no summary.json). "
        "Choose another folder, or remove this one."
    )
    file = target / "chapter.txt"
    assert refusal(filled, file) == f"{file}: exists and is not a folder. Choose another name."
    assert refusal(filled, file / "run") == (
        f"{file / 'run'}: cannot be written (Not a directory). "
        "Choose another folder, or check its permissions."
    )


def test_a_file_is_replaced_as_a_whole_or_not_at_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "summary.json"
    atomic_write_text(path, "one £\n")
    atomic_write_text(path, "two £\n")
    monkeypatch.setattr("os.replace", full)
    with pytest.raises(OSError, match="No space"):
        atomic_write_text(path, "three")
    assert path.read_bytes() == "two £\n".encode()
    assert list(tmp_path.iterdir()) == [path]


# --- targets ------------------------------------------------------------------------------------


def test_links_are_refused_before_anything_is_computed(tmp_path: Path) -> None:
    link = tmp_path / "link"
    link.symlink_to(tmp_path / "nowhere")
    assert refusal(check_target, link) == (
        f"{link}: is a symbolic link that leads nowhere. Remove it, or choose another name."
    )
    thesis = tmp_path / "thesis"
    thesis.mkdir()
    (thesis / "chapter").touch()
    link.unlink()
    link.symlink_to(thesis)
    assert refusal(check_target, link) == (
        f"{link}: links to {thesis}, which is not a run folder (it has no summary.json). "
        "Choose another folder, or remove this one."
    )
    assert refusal(check_file, link) == (
        f"{link}: is a symbolic link. Name the file itself, or choose another name."
    )
    assert (
        refusal(check_file, thesis) == f"{thesis}: exists and is not a file. Choose another name."
    )


def test_a_link_to_a_run_is_followed(tmp_path: Path) -> None:
    run = tmp_path / "disk" / "run"
    run.mkdir(parents=True)  # an empty folder is filled
    link = tmp_path / "link"
    with atomic_folder(run) as aside:
        (aside / "summary.json").write_text("old", encoding="utf-8")
        (aside / "steps.parquet").write_text("old", encoding="utf-8")
    link.symlink_to(run)
    filled(link, "new")
    assert link.is_symlink()
    assert (run / "summary.json").read_text(encoding="utf-8") == "new"
    assert [p.name for p in run.iterdir()] == ["summary.json"]
    assert [p.name for p in run.parent.iterdir()] == ["run"]


def test_names_that_no_file_system_takes_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be written \\(File name too long\\)"):
        check_target(tmp_path / ("x" * 300))


def test_folders_of_a_sweep_stay_in_it() -> None:
    names = [
        folder_name(name, value)
        for name in ("tiers.../../x", "tiers./x", "tiers.x")
        for value in (0.5, 1.0)
    ] + [folder_name("tiers." + "y" * 300, 1)]
    assert len(set(names)) == len(names)
    assert all("/" not in name and len(name.encode()) < 255 for name in names)
    assert names[-2] == "tiers.x=1"


# --- a full disk ----------------------------------------------------------------------------------


def full(*_: object, error: int = errno.ENOSPC, **__: object) -> None:
    """What writing to a full disk does."""
    raise OSError(error, os.strerror(error))


@pytest.mark.parametrize("error", [errno.ENOSPC, errno.EFBIG, errno.EDQUOT])
def test_a_full_disk_says_so_and_keeps_the_old_run(tmp_path: Path, error: int) -> None:
    target = tmp_path / "run"
    with pytest.raises(StorageError) as caught, atomic_folder(target):
        full(error=error)
    assert str(caught.value) == (
        f"{target}: the disk is full, or a quota is reached; nothing was written. "
        "Free some space, or write to another disk."
    )
    filled(target, "old")
    with pytest.raises(StorageError) as caught, atomic_folder(target):
        full(error=error)
    assert "; what was there before is kept. " in str(caught.value)
    assert (target / "summary.json").read_text(encoding="utf-8") == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["run"]


def test_a_page_on_a_full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.replace", full)
    with pytest.raises(StorageError, match=r"page\.html: the disk is full, or a quota is"):
        write_page(tmp_path / "page.html", "text")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("failure", "error", "words"), [
    (OSError(errno.ENOSPC, "no space"), StorageError,
        "the disk is full, or a quota is reached: figures and report were not written. "
        "Free some space: {folder} holds the run; make its report with vppres report {folder}."),
    (ValueError("$"), ReportError, "figures and report could not be made (ValueError: $). "
        "{folder} holds the run; make its report with vppres report {folder}."),
])  # fmt: skip
def test_a_day_is_kept_where_its_report_cannot_be_made(
    tiny: Scenario,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    failure: Exception,
    error: type[Exception],
    words: str,
) -> None:
    run = run_day(tiny, RunOptions(horizon_h=0.0))
    folder = tmp_path / "run"

    def fail(*_: object) -> None:
        raise failure

    monkeypatch.setattr(run_folder, "save_figures", fail)
    with pytest.raises(error) as caught:
        write_run(run, folder)
    assert str(caught.value) == f"{folder}: " + words.format(folder=folder)
    assert not (folder / "report.html").exists()
    kept = read_finished(folder)
    assert kept.trajectory.steps["p_grid_kw"].tolist() == run.steps["p_grid_kw"].tolist()


# --- signals --------------------------------------------------------------------------------------


@pytest.mark.nightly
@pytest.mark.skipif(sys.platform == "win32", reason="no such signal")
def test_sigterm_ends_a_run_like_ctrl_c(tiny_folder: Path, tmp_path: Path) -> None:
    """Terminated while it computes: status 143, nothing left behind."""
    place = tmp_path / "out"
    place.mkdir()
    code = textwrap.dedent("""
        import os, signal, sys
        import vppres.day.simulate as simulate
        from vppres.cli.commands import main
        step = simulate.Day.step

        def killed(self, controller, t):
            step(self, controller, t)
            if t == 1:
                os.kill(os.getpid(), signal.SIGTERM)

        simulate.Day.step = killed
        sys.argv = ["vppres", "run", sys.argv[1], "--out", sys.argv[2], "--horizon", "0"]
        main()
    """)
    done = subprocess.run(
        [sys.executable, "-c", code, str(tiny_folder), str(place / "run")],
        text=True,
        capture_output=True,
    )
    assert done.returncode == 128 + signal.SIGTERM
    assert done.stderr == "Terminated; nothing was written.\n"
    assert list(place.iterdir()) == []


def test_a_folder_that_takes_nothing_new_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def absent(self: Path, *_: object, **__: object) -> None:
        if self.name.endswith(".vppres-part"):
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(self))

    # As in /proc, which exists, allows everything to root, and has room for no name.
    monkeypatch.setattr(Path, "mkdir", absent)
    assert refusal(filled, tmp_path / "run") == (
        f"{tmp_path / 'run'}: cannot be written (No such file or directory). "
        "Choose another folder, or check its permissions."
    )


@pytest.mark.skipif(sys.platform == "win32", reason="no such signal")
def test_sigterm_before_a_command_has_begun() -> None:
    """Outside of a command's own block typer would end with the status of Ctrl-C."""
    code = textwrap.dedent("""
        import os, signal, sys
        from vppres.cli import commands, options

        options.plain_errors = lambda debug: os.kill(os.getpid(), signal.SIGTERM)
        sys.argv = ["vppres", "scenarios"]
        commands.main()
    """)
    done = subprocess.run([sys.executable, "-c", code], text=True, capture_output=True)
    assert done.returncode == 128 + signal.SIGTERM


@pytest.mark.nightly
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="looks into /proc")
def test_killed_commands_leave_the_old_result_and_no_process(
    tiny_folder: Path, tmp_path: Path
) -> None:
    """In a process of its own, since it makes copies of itself."""
    command = [sys.executable, "-m", "tests.support.kills", str(tiny_folder), str(KILLS), "1"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert json.loads(done.stdout) == []


@pytest.mark.skipif(sys.platform != "linux", reason="names of open files are read in /proc")
def test_what_takes_a_name_is_on_the_disk_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A machine that loses power may have renamed a folder whose files are still empty."""
    done = list[tuple[str, str]]()
    fsync = os.fsync
    replace = os.replace

    def settled(descriptor: int) -> None:
        done.append(("settled", Path(os.readlink(f"/proc/self/fd/{descriptor}")).name))
        fsync(descriptor)

    def renamed(one: Path, other: Path) -> None:
        done.append(("renamed", Path(other).name))
        replace(one, other)

    monkeypatch.setattr(os, "fsync", settled)
    monkeypatch.setattr(os, "replace", renamed)
    with atomic_folder(tmp_path / "run") as aside:
        (aside / "figures").mkdir()
        (aside / "figures" / "day.svg").write_text("<svg/>")
        (aside / "summary.json").write_text("{}")
    before = {name for kind, name in done[: done.index(("renamed", "run"))]}
    assert {"figures", "day.svg", "summary.json", aside.name} == before
    assert done[-1] == ("settled", tmp_path.name)
    done.clear()
    atomic_write_text(tmp_path / "one.json", "{}")
    assert [kind for kind, _ in done] == ["settled", "renamed", "settled"]
    assert done[1:] == [("renamed", "one.json"), ("settled", tmp_path.name)]


@pytest.mark.skipif(sys.platform != "linux", reason="names of open files are read in /proc")
def test_a_drive_that_cannot_settle_folders_is_written_all_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fsync = os.fsync

    def picky(descriptor: int) -> None:
        if os.path.isdir(f"/proc/self/fd/{descriptor}"):
            raise OSError(errno.EINVAL, os.strerror(errno.EINVAL))
        fsync(descriptor)

    monkeypatch.setattr(os, "fsync", picky)
    filled(tmp_path / "run", "{}")
    assert (tmp_path / "run" / "summary.json").is_file()


def test_a_disk_that_is_full_only_when_it_settles_keeps_the_older_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    filled(tmp_path / "run", "old")
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(StorageError):
        filled(tmp_path / "run", "new")
    assert (tmp_path / "run" / "summary.json").read_text() == "old"
