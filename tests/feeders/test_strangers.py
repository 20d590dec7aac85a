"""Network files of strangers: whatever they ask for, nothing runs, is written or is imported."""

from __future__ import annotations

import codecs
import json
import os
import pickle
import re
import struct
import sys
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import pandapower as pp
import pandapower.networks as pp_networks
import pytest

from tests.support.processor import processor_s_below
from vppres.core.errors import InputError
from vppres.feeders import import_network
from vppres.feeders.dss import commands as dss_commands
from vppres.feeders.dss import script as dss_script
from vppres.feeders.dss.circuit import read_opendss
from vppres.feeders.strangers import confined

pytestmark = pytest.mark.filterwarnings("ignore::FutureWarning", "ignore::DeprecationWarning")

LONGEST_S = 10.0
CIRCUIT = """clear
new circuit.mill basekv=11 bus1=src phases=3
new line.head bus1=src bus2=a phases=3 r1=0.3 x1=0.2
new load.d bus1=a phases=3 kv=11 kw=50 kvar=10
set voltagebases=[11]
"""


# What a process does, seen by the interpreter itself: it cannot be looked past.

WATCHED: list[tuple[str, str]] = []
WATCHING: list[bool] = []


def _watch(event: str, arguments: tuple[Any, ...]) -> None:
    if WATCHING and event in (
        "import",
        "open",
        "subprocess.Popen",
        "os.system",
        "os.exec",
        "os.posix_spawn",
        "os.fork",
        "ctypes.dlopen",
        "os.remove",
        "os.rename",
        "os.mkdir",
        "os.symlink",
        "socket.connect",
        "webbrowser.open",
        "pickle.find_class",
        "exec",
        "compile",
    ):
        WATCHED.append((event, " ".join(str(argument) for argument in arguments)))


sys.addaudithook(_watch)


@pytest.fixture(scope="module", autouse=True)
def _libraries() -> None:
    """What the import of any network loads is loaded before anything is watched."""
    import_network(pp_networks.case33bw())
    codecs.lookup("utf-8-sig")


@pytest.fixture
def house(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder for the stranger's file, beside things that are none of its business."""
    (tmp_path / "secret.txt").write_text("the-secret is mine\n")
    (tmp_path / "secret.dss").write_text("the-secret is mine\n")
    (tmp_path / "circuit.dss").write_text(CIRCUIT)
    (tmp_path / "table.json").write_text('{"columns":["the-secret"],"index":[0],"data":[[1]]}')
    (tmp_path / "canary_module.py").write_text(
        f"open({str(tmp_path / 'canary')!r}, 'w').write('run')\nclass Bird: pass\n"
    )
    folder = tmp_path / "stranger"
    folder.mkdir()
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.chdir(folder)
    return folder


def everything(root: Path) -> dict[str, bytes]:
    """Names and contents of all regular files."""
    return {
        str(file.relative_to(root)): file.read_bytes()
        for file in sorted(root.rglob("*"))
        if file.is_file() and not file.is_symlink() and file.stat().st_size < 1_000_000
    }


def refused(file: Path) -> str:
    """The message with which a file is refused; nothing else has happened."""
    with harmless(file), pytest.raises(InputError) as caught:
        import_network(file)
    message = str(caught.value)
    assert "the-secret" not in message
    assert len(message) < 20_000
    return message


@contextmanager
def harmless(file: Path) -> Iterator[None]:
    """A file is read, and nothing else happens."""
    root = file.parent.parent
    before = everything(root)
    modules = set(sys.modules)
    WATCHED.clear()
    WATCHING.append(True)
    try:
        with processor_s_below(LONGEST_S):
            yield
    finally:
        WATCHING.clear()
    assert everything(root) == before
    assert not (root / "canary").exists()
    assert all(m.startswith(("vppres.", "scipy.")) for m in set(sys.modules) - modules)
    for event, arguments in WATCHED:
        assert "canary" not in arguments, (event, arguments)
        assert "the-secret" not in arguments, (event, arguments)
        if event == "subprocess.Popen":
            assert str(Path(confined.__file__).with_name("child.py")) in arguments
        assert event not in (
            "os.system",
            "os.exec",
            "os.posix_spawn",
            "ctypes.dlopen",
            "socket.connect",
            "webbrowser.open",
            "pickle.find_class",
        )


def master(house: Path, *lines: str) -> Path:
    """A circuit that would be read, with the lines at its end."""
    file = house / "mill.dss"
    file.write_text(CIRCUIT + "\n".join(lines) + "\n", newline="")
    return file


def test_the_circuit_without_hostile_lines_is_read(house: Path) -> None:
    assert import_network(master(house)).network.buses.tolist() == ["vsource", "src", "a"]


ROW = "mill.dss, row 6"
NOT_NEEDED = "is not a command that a network needs. Remove the line"
CODE = "which names code. Remove it."
NO_PROPERTY = "which is not a property of OpenDSS."
NO_FILE = "which is not in the master's folder."
OUT = "leads out of the master's folder"
LINES = {
    # kind 2: comments that hide a command, or seem to
    "comment in a value": (["new load.e bus1=a!\rkw=1"], "'kw' names no element"),
    "quote over a comment": (['new load.e bus1="a ! b'], "a quote that is not closed"),
    "control character": (["new load.e bus1=a\x0bexport"], "has a control character"),
    "no verb": (["= canary"], "has an '=' without a name before it"),
    "too long": (["new load.e bus1=a zipv=[" + "1 " * 600_000 + "x]"], "has more than 1000000"),
    # kind 5: other people's files
    "absolute": (["redirect /etc/passwd"], "names the file /etc/passwd"),
    "above": (["redirect ../secret.txt"], OUT),
    "two above": (["redirect ../../secret.dss"], OUT),
    "abbreviated": (["redir ../secret.txt"], OUT),
    "quoted": (["redirect [../secret.txt]"], OUT),
    "not a data sheet": (["redirect ../secret.dss"], "is not a data sheet"),
    "circuit above": (["redirect ../circuit.dss"], "is not a data sheet"),
    "backslashes": (["compile ..\\..\\secret.dss"], OUT),
    "home": (["redirect ~/.profile"], "names the file ~/.profile"),
    "url": (["redirect http:x"], "names the file http:x"),
    # kind 6: code of the user's, by any part of the name or by its place
    "user model": (["new generator.g bus1=a usermodel=canary.so"], CODE),
    "user data": (["new generator.g bus1=a", "~ userdata=(canary)"], CODE),
    "user data of a load": (["~ userdata=(canary)"], NO_PROPERTY),
    "part of a name": (["new generator.g bus1=a USERM=canary.so"], CODE),
    "part of a name, blanks": (["new generator.g bus1=a user  =  [canary.so]"], CODE),
    "shaft": (["new generator.g bus1=a shaftm=canary.so shaftd=x"], CODE),
    "by its place": (["new generator.g bus1=a shaftd=x canary"], CODE),
    "behind the one before": (["new pvsystem.p bus1=a class=1 canary.so"], CODE),
    "pv model": (["new pvsystem.p bus1=a usermodel=canary.dll"], CODE),
    "storage library": (["new storage.s bus1=a dynadll=canary"], CODE),
    "storage library, part": (["new storage.s bus1=a dynad=canary"], CODE),
    "edited model": (["generator.g.usermodel=canary.so"], CODE),
    "edited model, part": (["generator.g.userm=canary.so"], CODE),
    "control": (["new capcontrol.c usermodel=canary.so"], CODE),
    "equations": (["new generator.g bus1=a dynamiceq=canary"], CODE),
    # kind 7: substitution
    "variable": (["var @x=canary"], "has '@', which stands for a variable"),
    "variable in a value": (["new load.e bus1=@x"], "has '@', which stands for a variable"),
    "batchedit": (["batchedit generator..* userm=canary.so"], CODE),
    "batchedit, more": (["batchedit (load..* kw=1 | x) kw=1"], "is not a name"),
    "batchedit, quotes": (["batchedit 'load..* (x)' kw=1"], "is not a pattern"),
    "allocateloads": (["allocateloads"], f"'allocateloads' {NOT_NEEDED}"),
    "edits of many": (["reduce all"], f"'reduce' {NOT_NEEDED}"),
    "arithmetic": (["new load.e bus1=a kw=(1 2 system)"], "OpenDSS refuses the file ("),
    "quoted name": (["new \"load.e' ' kw=1"], "a quote that is not closed"),
    "name with a value": (["new 'load.e=1' kw=1"], "is not a name"),
    "name with a quote": (['new (load."e) kw=1'], "is not a name"),
    # kind 8: series in files
    "csv": (["new loadshape.s npts=9 csvfile=/etc/passwd"], NO_FILE),
    "csv, part": (["new loadshape.s npts=9 c=/etc/passwd"], NO_FILE),
    "csv by its place": (["new loadshape.s 9 1 [1] [1] 1 1 ../secret.txt"], NO_FILE),
    "dbl": (["new loadshape.s npts=9 dblfile=../secret.txt"], NO_FILE),
    "sng": (["new loadshape.s npts=9 sngfile=../secret.txt"], NO_FILE),
    "in an array": (["new loadshape.s npts=9 mult=(file=/etc/passwd)"], NO_FILE),
    "in an array, quoted": (["new loadshape.s npts=9 mult=(file='/etc/passwd')"], NO_FILE),
    "csv in an array": (["new loadshape.s npts=9 mult=[csvfile=../secret.txt]"], NO_FILE),
    "in an array of a load": (["edit load.d zipv=(file=/etc/passwd)"], NO_FILE),
    "binary in an array": (["new loadshape.s npts=9 mult={dblfile = ../secret.txt}"], NO_FILE),
    "no series": (["new loadshape.s npts=9 mult=(fil=../secret.txt)"], "is not a value"),
    "edited": (["loadshape.s.csvfile=/etc/passwd"], NO_FILE),
    "spectrum": (["new spectrum.s numharm=1 csvfile=../secret.txt"], NO_FILE),
    "prices": (["new priceshape.s npts=9 csvf=/etc/passwd"], NO_FILE),
    "curve": (["new xycurve.s npts=2 sngf=../secret.txt"], NO_FILE),
    "fuse": (["new tcc_curve.s npts=2 c_array=(file=/etc/passwd) t_array=(1 2)"], NO_FILE),
    "temperatures": (["new tshape.s npts=2 csvfile=..\\secret.txt"], NO_FILE),
    # kind 9: work without end
    "redirect to itself": (["redirect mill.dss"], "which is read already"),
    # kind 10: sizes, which spoil the voltages of all else
    "power": (["new load.e bus1=a kw=1e30"], "kw = 1e30, a size that no equipment has"),
    "energy": (["new storage.s bus1=a kwhrated=1E30"], "kwhrated = 1E30, a size that no equipment"),
    "length": (["new line.x a b length = -1e30"], "length = -1e30, a size that no equipment has"),
    "ratings": (["new transformer.q kvas=[1e30, 5]"], "kvas = 1e30, a size that no equipment has"),
    "impedance": (["new linecode.q rmatrix=(1 | 0 2e20)"], "rmatrix = 2e20, a size that no"),
    "beyond numbers": (["new line.x a b r1=1e999"], "r1 = 1e999, a size that no equipment has"),
    "product": (["new load.e bus1=a kw=(10 1e308 * 1e308 *)"], "1e308, a size that no equipment"),
    "brackets": (["new load.e bus1=a kw=" + "(" * 5000], "a quote that is not closed"),
    "in full": (["load.d.kw=10000000000000000000"], "a size that no equipment has"),
}


@pytest.mark.parametrize("name", LINES)
def test_hostile_lines_of_opendss(name: str, house: Path) -> None:
    lines, reason = LINES[name]
    message = refused(master(house, *lines))
    assert message.startswith("mill.dss, row ") or message.startswith("../")
    assert reason in message
    if len(lines) == 1 and "\r" not in lines[0] and not message.startswith("../"):
        assert message.startswith(f"{ROW}: ")


IGNORED = {
    # kind 1: a program as editor, and windows
    "editor": ["set editor=/bin/touch"],
    "editor quoted": ['SET "editor"="touch canary"'],
    "editor by a part": ["set edit=/bin/touch"],
    "editor second": ["set tolerance=1e-5 editor=x"],
    "fileedit": ["fileedit canary"],
    "formedit": ["formedit load.d"],
    "doscmd": ['doscmd "touch canary"'],
    "doscmd by a part": ['dos "touch canary"'],
    # kind 2: comments that hide a command, or seem to
    "after a comment": ["/* a", "b */ fileedit canary"],
    "comment in a line": ["/* a */ set editor=touch"],
    "carriage return": ["! a comment\rexport voltages canary"],
    # kind 3: files written
    "export": ["export voltages canary"],
    "save": ["save circuit dir=../canary"],
    "cd": ["cd .."],
    "datapath": ["set datapath=.."],
    "recorder": ["set recorder=yes"],
    "dump": ["dump debug"],
    "demand files": ["set demand=true"],
    "log": ["set tracecontrol=yes log=yes"],
    "case": ["set casename=../../canary"],
    "monitor": ["new monitor.m element=line.head mode=0", "~ action=save"],
    "meter": ["new energymeter.m element=line.head", "edit energymeter.m action=save"],
    "debugtrace": ["new generator.g bus1=a kw=0 debugtrace=yes"],
    "debugtrace, part": [
        "new generator.g bus1=a kw=0 debug=yes",
        "batchedit generator..* debug=yes",
    ],
    # kind 4: windows and browsers
    "show": ["show voltages"],
    "plot": ["plot profile"],
    "visualize": ["visualize powers line.head"],
    "query": ["? load.d.kw"],
    # kind 9: work without end
    "solve for ever": ["solve mode=yearly number=1000000000"],
    "mode": ["set number=1000000000"],
    "mode of a study": ["set mode=(export canary)"],
    "many lines": ["export voltages canary"] * 50_000,
}


@pytest.mark.parametrize("name", IGNORED)
def test_lines_that_build_nothing_are_not_carried_out(name: str, house: Path) -> None:
    file = master(house, *IGNORED[name])
    with harmless(file):
        feeder = import_network(file)
    assert feeder.p_load_kw.sum() == 50.0
    told = any(" left out: " in note for note in feeder.notes)
    assert told or name in ("monitor", "meter", "debugtrace", "debugtrace, part")


def test_opendss_gets_full_names_and_no_files(house: Path) -> None:
    """What is abbreviated, by its place or in a file is written anew; nothing else is."""
    (house / "day.csv").write_text("1\n0.5\n")
    lines = ("new loadshape.s npts=2 mu=(file=day.csv) use=no", "new load.e 3 a kv=(10 1 +) kw=5!x")
    script = dss_script.read_script(master(house, *lines, "new load.f bus=a%q kw=.5"))
    engine = dss_commands.Commands(script.files)
    texts = [engine.text(c.verb, c.target, [[*v] for v in c.values]) for c in script.commands]
    assert texts[-3:] == [
        'new "loadshape.s" npts=2 mult=[1 0.5] useactual=no',
        'new "load.e" phases=3 bus1=a kv=(10 1 +) kw=5',
        'new "load.f" bus1=a%q kw=.5',
    ]


def test_every_property_of_the_engine_that_names_code_or_a_file_is_known() -> None:
    """A new release of OpenDSS may bring more of them."""
    pytest.importorskip("opendssdirect")
    doubtful = re.compile(r"file|dll|data$|trace|path|script|user|shaft|command|exec")
    known = {"xfmrcode", "usermodel", "linecode"}
    for kind, names in dss_commands._schema().items():
        for name in names:
            if doubtful.search(name) and name not in known:
                allowed = name in (*dss_commands.FILES, dss_commands.TRACES)
                allowed = allowed or dss_commands.CODE.fullmatch(name)
                assert allowed, (kind, name)


def many_levels(house: Path) -> Path:
    for level in range(40):
        (house / f"f{level}.dss").write_text(f"redirect f{level + 1}.dss\n")
    return master(house, "redirect f0.dss")


def circle(house: Path) -> Path:
    (house / "b.dss").write_text("redirect c.dss\n")
    (house / "c.dss").write_text("redirect b.dss\n")
    return master(house, "redirect b.dss")


def link_out(house: Path) -> Path:
    (house / "link.txt").symlink_to(house.parent / "secret.txt")
    return master(house, "redirect link.txt")


def link_circle(house: Path) -> Path:
    (house / "one.dss").symlink_to(house / "two.dss")
    (house / "two.dss").symlink_to(house / "one.dss")
    return master(house, "redirect one.dss")


def pipe(house: Path) -> Path:
    os.mkfifo(house / "pipe.dss")
    return master(house, "redirect pipe.dss")


def long_file(house: Path) -> Path:
    return master(house, "! " + "x" * (33 * 2**20))


def long_line(house: Path) -> Path:
    return master(house, "new load.e bus1=a zipv=[" + "1 " * 2_000_000 + "x]")


def many_lines(house: Path) -> Path:
    return master(house, *["allocateloads"] * 200_000)


def link_to_a_series(house: Path) -> Path:
    (house / "link.csv").symlink_to(house.parent / "secret.txt")
    return master(house, "new loadshape.s npts=9 csvfile=link.csv")


def link_to_a_folder(house: Path) -> Path:
    (house / "sub").symlink_to(house.parent)
    return master(house, "redirect sub/secret.txt")


def out_of_a_folder(house: Path) -> Path:
    (house / "sub").mkdir()
    (house / "sub" / "b.dss").write_text("redirect ../../secret.txt\n")
    return master(house, "compile sub/b.dss", "redirect ../../secret.txt")


def pipe_of_a_series(house: Path) -> Path:
    os.mkfifo(house / "pipe.csv")
    return master(house, "new loadshape.s npts=9 mult=(file=pipe.csv)")


def words_as_a_series(house: Path) -> Path:
    (house / "words.csv").write_text("1,2\ncanary,3\n")
    return master(house, "new loadshape.s npts=9 csvfile=words.csv")


def too_many_phases(house: Path) -> Path:
    return master(house, "new line.e bus1=a bus2=b phases=30000 r1=1 x1=1", "calcv")


def device(house: Path) -> Path:
    (house / "zero.dss").symlink_to("/dev/zero")
    return master(house, "redirect zero.dss")


def device_of_a_series(house: Path) -> Path:
    (house / "zero.bin").symlink_to("/dev/zero")
    return master(house, "new loadshape.s npts=9 sngfile=zero.bin")


def folder_as_a_series(house: Path) -> Path:
    (house / "sub.csv").mkdir()
    return master(house, "new loadshape.s npts=9 mult=(file=sub.csv)")


def half_a_number(house: Path) -> Path:
    (house / "half.bin").write_bytes(b"12345")
    return master(house, "new loadshape.s npts=9 dblfile=half.bin")


def no_numbers(house: Path) -> Path:
    (house / "nan.bin").write_bytes(b"\xff" * 32)
    return master(house, "new loadshape.s npts=4 mult=(dblfile=nan.bin)")


def windings(house: Path) -> Path:
    return master(house, "new transformer.q windings=100000000", "calcv")


FILES: dict[str, tuple[Callable[[Path], Path], str]] = {
    "levels": (many_levels, "files are read 10 deep"),
    "circle": (circle, "which is read already"),
    "link out": (link_out, OUT),
    "link circle": (link_circle, OUT),
    "pipe": (pipe, "there is no such file"),
    "link to a series": (link_to_a_series, NO_FILE),
    "link to a folder": (link_to_a_folder, OUT),
    "out of a folder": (out_of_a_folder, OUT),
    "pipe of a series": (pipe_of_a_series, NO_FILE),
    "words as a series": (words_as_a_series, "holds no columns of numbers"),
    "device": (device, OUT),
    "device of a series": (device_of_a_series, NO_FILE),
    "folder as a series": (folder_as_a_series, NO_FILE),
    "half a number": (half_a_number, "holds no numbers of 8 bytes"),
    "no numbers": (no_numbers, "holds no numbers of 8 bytes"),
    "windings": (windings, "mill.dss: "),
    "long file": (long_file, "has more than 32 MB"),
    "long line": (long_line, "has more than 1000000 characters"),
    "many lines": (many_lines, "more lines like these"),
    "phases": (too_many_phases, "mill.dss: "),  # OpenDSS 0.14 does not survive it
}


@pytest.mark.parametrize("name", FILES)
def test_hostile_files_of_opendss(name: str, house: Path) -> None:
    make, reason = FILES[name]
    assert reason in refused(make(house))


# kind 10 and more: pandapower's JSON

NO_OBJECT = "which is not an object of a net. Remove it, or write the net anew with"


def small_net() -> Any:
    net = pp.create_empty_network()
    pp.create_buses(net, 2, vn_kv=11.0)
    pp.create_ext_grid(net, 0)
    pp.create_line_from_parameters(net, 0, 1, 1.0, 0.3, 0.2, 0.0, 1.0)
    pp.create_load(net, 1, p_mw=0.05)
    return net


@cache
def small_text() -> str:
    """The small net's text; pandapower takes a quarter of a second for it."""
    return str(pp.to_json(small_net()))


def made_of(changes: dict[str, Any]) -> str:
    """A net's text with more entries."""
    text = json.loads(small_text())
    text["_object"].update(changes)
    return json.dumps(text)


def named(module: str, kind: str, content: Any = "x", **more: Any) -> dict[str, Any]:
    return {"_module": module, "_class": kind, "_object": content, **more}


def frame(cell: Any) -> dict[str, Any]:
    """A table with one cell."""
    return named(
        "pandas.core.frame",
        "DataFrame",
        json.dumps({"columns": ["a"], "index": [0], "data": [[cell]]}),
        orient="split",
        dtype={"a": "object"},
    )


BIRD = named("canary_module", "Bird")
DEEP: Any = "x"
for _ in range(40):
    DEEP = [DEEP]
TEXTS: dict[str, tuple[str, str]] = {
    "module": (made_of({"x": BIRD}), f"canary_module.Bird, {NO_OBJECT}"),
    "instead of a net": (json.dumps(BIRD), f"canary_module.Bird, {NO_OBJECT}"),
    "in a cell": (made_of({"x": frame(BIRD)}), "canary_module.Bird, "),
    "in a text in a cell": (
        made_of({"x": frame(json.dumps(json.dumps(BIRD)))}),
        "canary_module.Bird, ",
    ),
    "in a list": (made_of({"x": [[{"y": BIRD}]]}), "canary_module.Bird, "),
    "in a net in a net": (
        json.dumps(named("pandapower.auxiliary", "pandapowerNet", made_of({"x": BIRD}))),
        "canary_module.Bird, ",
    ),
    "escaped": (
        made_of({"x": json.dumps(json.dumps(BIRD)).replace("_module", "\\u005fmodule")}),
        "canary_module.Bird, ",
    ),
    "lenient": (
        made_of({"x": "{'_module': 'canary_module', '_class': 'Bird'}"}),
        "has a text that names a module and is not JSON",
    ),
    "twice": (
        made_of({"x": {}}).replace(
            '"x": {}', '"x": {"_module": "canary_module", "_class": "Bird", "_module": "numpy"}'
        ),
        "has an object with the same key twice",
    ),
    "system": (made_of({"x": named("posix", "system", "touch canary")}), "posix.system, "),
    "eval": (made_of({"x": named("builtins", "eval", "open('canary', 'w')")}), "builtins.eval, "),
    "function": (
        made_of({"x": named("canary_module", "function", "Bird")}),
        "canary_module.function, ",
    ),
    "function of a controller": (
        made_of({"x": named("pandapower.control.run_control", "function", "run_control")}),
        "pandapower.control.run_control.function, ",
    ),
    "pickle": (
        made_of({"x": named("pandas.io.pickle", "read_pickle", "canary.p")}),
        "pandas.io.pickle.read_pickle, ",
    ),
    "load": (
        made_of({"x": named("numpy", "load", "canary.npy", allow_pickle=True)}),
        "numpy.load, ",
    ),
    "no class": (made_of({"x": {"_module": "canary_module"}}), "canary_module.None, "),
    "path": (
        made_of({"x": named("pandas.core.frame", "DataFrame", "PATH/table.json", orient="split")}),
        "has a table that is not given as JSON",
    ),
    "setting": (
        made_of({"x": {**frame(1), "storage_options": {"a": 1}}}),
        "gives DataFrame the setting 'storage_options'",
    ),
    "deep": (made_of({"x": DEEP}), "nests deeper than 30 levels"),
    "very deep": ("[" * 200_000 + "]" * 200_000, "cannot be read as pandapower JSON"),
    "many objects": (f"[{'{},' * 1_000_000}1]", "has more than 1000000 objects and lists"),
    "many digits": (made_of({"f_hz": 10**399}), "net.json: cannot be read as a network ("),
    "narrow table": (
        made_of({"load": frame(1)}),
        "net.json: cannot be read as a network (lacks 'bus'). Correct the file",
    ),
    "long": (" " * (33 * 2**20), "has more than 32 MB"),
}


@pytest.mark.parametrize("name", TEXTS)
def test_hostile_pandapower_files(name: str, house: Path) -> None:
    text, reason = TEXTS[name]
    file = house / "net.json"
    file.write_text(text.replace("PATH", str(house.parent)))
    message = refused(file)
    assert message.startswith("net.json: ")
    assert reason in message


def test_honest_pandapower_files_are_read_and_controllers_not_imported(house: Path) -> None:
    file = house / "net.json"
    more = {
        "x": frame("a text"),
        "y": named("numpy", "float64", 1.0),
        "z": named("builtins", "tuple", [1, 2]),
        "w": frame(named("pandapower.control.canary", "Bird")),
    }
    file.write_text(made_of(more))
    feeder = import_network(file)
    assert "pandapower.control.canary" not in sys.modules
    assert feeder.network.buses.tolist() == [0, 1]
    assert feeder.notes == ("Controllers and protection of the source do not act.",)


# MATLAB's files, and what is never opened


class Bomb:
    """A pickle that writes a file where it is opened."""

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[str, ...]]:
        return os.mkdir, ("canary",)


def mat_element(kind: int, content: bytes) -> bytes:
    return struct.pack("<II", kind, len(content)) + content


def mat_file(*elements: bytes) -> bytes:
    head = b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<H", 0x0100) + b"IM"
    return head + b"".join(elements)


def matrix(kind: int, name: bytes, *rest: bytes) -> bytes:
    """A matrix of one element: flags, dimensions, name, and what it holds."""
    return mat_element(
        14,
        mat_element(6, struct.pack("<II", kind, 0))
        + mat_element(5, struct.pack("<ii", 1, 1))
        + mat_element(1, name.ljust(8, b"\0"))
        + b"".join(rest),
    )


def nested_cells(depth: int) -> bytes:
    """A cell in a cell in a cell; the reader of the format goes down by recursion."""
    inner = matrix(6, b"", mat_element(9, struct.pack("<d", 1.0)))
    for _ in range(depth):
        inner = matrix(1, b"mpc" if _ == depth - 1 else b"", inner)
    return inner


def unpacking_to(size: int) -> bytes:
    """Zeros that take a thousandth of their size."""
    raw = mat_element(
        14,
        mat_element(6, struct.pack("<II", 6, 0))
        + mat_element(5, struct.pack("<ii", 1, size // 8))
        + mat_element(1, b"mpc".ljust(8, b"\0"))
        + mat_element(9, bytes(size)),
    )
    return mat_file(mat_element(15, zlib.compress(raw, 9)))


BINARIES: dict[str, tuple[str, Callable[[], bytes], str]] = {
    "pickle": ("net.p", lambda: pickle.dumps(Bomb()), "may be a pickle, which runs"),
    "pickle by another name": ("net.json", lambda: pickle.dumps(Bomb()), "cannot be read as"),
    "pickle as a matrix": ("net.mat", lambda: pickle.dumps(Bomb()), "cannot be read as"),
    "workbook": ("net.xlsx", lambda: b"PK", "is a workbook"),
    "program": ("net.py", lambda: b"open('canary', 'w')", "is a program"),
    "nested": ("net.mat", lambda: mat_file(nested_cells(20_000)), "net.mat: "),
    "zeros": ("net.mat", lambda: unpacking_to(200 * 2**20), "cannot be read as"),
    "no mpc": ("net.mat", lambda: mat_file(), "cannot be read as"),
    "long": ("net.mat", lambda: bytes(11 * 2**20), "has more than 10 MB"),
    "computes": (
        "net.m",
        lambda: b"function mpc = c\nmpc.bus = 1;\nmpc.bus(1, 1) = system(7);\n",
        "net.m, row 3: calls 'system', which is not evaluated",
    ),
    "calls": (
        "net.m",
        lambda: b"function mpc = c\nsystem('touch canary');\n",
        "net.m, row 2: has 'system', which is not evaluated",
    ),
    "many names": (
        "net.m",
        lambda: b"function mpc = c\n" + b"mpc.bus = [\n" * 400_000,
        "net.m, row 2: has the character '='",
    ),
    "blanks": (
        "net.m",
        lambda: b"function mpc = c\nx" + b" " * 200_000 + b"y\n",
        "net.m, row 2: has 'x', which is not evaluated",
    ),
    "empty lines": ("net.m", lambda: b"\n" * 2**20, "mpc.baseMVA is missing"),
    "long text": ("net.m", lambda: b"%" * (11 * 2**20), "has more than 10 MB"),
}


BY_NIGHT = {"pickle as a matrix", "no mpc", "zeros", "calls", "long text"}


@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=pytest.mark.nightly if n in BY_NIGHT else ()) for n in BINARIES],
)
def test_hostile_matlab_files_and_others(name: str, house: Path) -> None:
    file_name, content, reason = BINARIES[name]
    file = house / file_name
    file.write_bytes(content())
    assert reason in refused(file)
    assert not (house / "canary").exists()


# The process in which files are read


def test_a_reader_that_does_not_end_is_ended(house: Path) -> None:
    too_slow = pytest.raises(InputError, match=r"^mill\.dss: is not read within 0\.001 s\. Give ")
    with processor_s_below(LONGEST_S), too_slow:
        read_opendss(
            master(
                house, *[f"new line.l{i} bus1=a bus2=b{i} phases=3 r1=1 x1=1" for i in range(5000)]
            ),
            time_limit_s=0.001,
        )


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such limits")
def test_the_process_can_write_no_file(house: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Past the check: even if a command that writes went through it, nothing would come of it.
    canary = house.parent / "canary.csv"
    script = dss_script.read_script(master(house))
    commands = (
        *script.commands,
        dss_script.Command("mill.dss", 1, "solve"),
        dss_script.Command("mill.dss", 1, f"export voltages {canary}"),
    )
    monkeypatch.setattr(dss_script, "read_script", lambda path: dss_script.Script(commands, ()))
    with pytest.raises(InputError, match=r"OpenDSS refuses the file|ends the process"):
        read_opendss(master(house))
    assert not canary.exists() or canary.read_bytes() == b""
    assert not [*house.glob("*voltages*"), *house.glob("*VOLTAGES*")]


def test_files_beside_and_below_the_master_are_read_in_their_place(house: Path) -> None:
    (house / "lines").mkdir()
    (house / "lines" / "tail.dss").write_text(
        "new line.tail bus1=a bus2=b phases=3 linecode=std length=2 units=km\n"
    )
    (house / "more.dss").write_text(
        "new load.e bus1=b phases=3 kv=11 kw=(20 2 /) kvar=1 ! a remark\n"
    )
    (house.parent / "codes.dss").write_text(
        "new linecode.std nphases=3 r1=0.1 x1=0.1\n~ units=km // as above\n"
    )
    feeder = import_network(
        master(
            house,
            "redirect ../codes.dss",
            "/* nothing",
            "here */",
            "redirect lines/tail.dss",
            "redirect more.dss",
            "calcv",
            "solve",
            "new loadshape.day npts=2 interval=12 mult=[1 0.5]",
            "load.d.daily=day",
            "new energymeter.m line.head 1",
        )
    )
    assert feeder.network.buses.tolist() == ["vsource", "src", "a", "b"]
    assert feeder.network.r_ohm[1:].tolist() == pytest.approx([0.3, 0.2])
    assert feeder.p_load_kw.tolist() == pytest.approx([0.0, 0.0, 50.0, 10.0])
