"""Files that this program did not write are opened in one way only, and JSON that others wrote is parsed in one.

Every call that opens, reads or parses a file is found in the source. It is listed below with its reason, or it is
``open_foreign`` or ``read_foreign`` of ``cbsr_qa/system/foreign.py``, and ``parsed_json``. Whoever adds a call
decides: is the file in this program's own folder, or did it come from outside?
"""

import ast
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

TOP = Path(__file__).resolve().parents[1]
ROOTS = (TOP / "cbsr_qa", TOP / "plugins" / "cbsr_qa_plugins")

#: Functions that open or parse a file, by their last name; with the module they are of where another has that name.
OPENING = {
    *("open", "read_text", "read_bytes", "fromfile", "memmap", "loadtxt", "genfromtxt", "loadmat", "read_csv"),
    *("read_parquet", "read_feather", "ParquetFile", "ParquetDataset", "ZipFile", "TarFile", "copyfile", "copy2"),
    *("copytree", "load_cert_chain", "read_table", "File", "fdopen", "FileIO", "mmap", "linecache", "getlines"),
    *("np.load", "tomllib.load", "json.load", "pickle.load", "pickle.loads", "pickle.Unpickler", "marshal.loads"),
    *("shutil.copy", "meshio.read", "sqlite3.connect", "ElementTree.parse", "minidom.parse", "runpy.run_path"),
    *("shelve.open", "dbm.open", "imread", ".load", ".loads", "json.loads", "open_file_image"),
}
LAST_NAMES = {name.rpartition(".")[2] for name in OPENING}
#: Of files that are written, a mode states that they are new, or only added to.
_WRITES = ("w", "x", "a")

OWN = "of this program's own folder, or package"
WRITES = "writes: what is there is not read"
CHECKED = "after check_regular or open_foreign of the same file"
MEMORY = "of bytes in memory, or of a file that open_foreign opened"
DATABASE = "of a database, under its digests"
NOT_A_FILE = "opens no file"
OPENER = "the opener, and the parser"
READER = "reads by the opener"

ALLOWED: dict[tuple[str, str], tuple[int, str]] = {
    ("cbsr_qa/analysis/recording_files.py", "h5py.File"): (2, MEMORY),
    ("cbsr_qa/app/certificate/compose.py", "json.loads"): (2, DATABASE),
    ("cbsr_qa/app/certificate/request.py", "json.loads"): (1, DATABASE),
    ("cbsr_qa/app/changes.py", "json.loads"): (1, DATABASE),
    ("cbsr_qa/app/export/netcdf.py", "h5py.File"): (1, MEMORY),
    ("cbsr_qa/app/reanalyse/judging.py", "json.loads"): (3, DATABASE),
    ("cbsr_qa/app/reanalyse/reanalysis.py", "json.loads"): (2, DATABASE),
    ("cbsr_qa/app/reanalyse/work.py", "json.loads"): (2, DATABASE),
    ("cbsr_qa/app/run/control.py", "_confirmation(run, session_at).read_text"): (1, OWN),
    ("cbsr_qa/app/run/decided_again.py", "json.loads"): (1, DATABASE),
    ("cbsr_qa/app/station_check/bench.py", "look.open"): (1, NOT_A_FILE),
    ("cbsr_qa/calibration/file/hdf5.py", "h5py.File"): (2, MEMORY),
    ("cbsr_qa/calibration/file/hdf5.py", "h5py.h5f.open_file_image"): (1, MEMORY),
    ("cbsr_qa/calibration/file/keys.py", "os.fdopen"): (1, WRITES),
    ("cbsr_qa/calibration/file/keys.py", "os.open"): (1, WRITES),
    ("cbsr_qa/calibration/presses/frame_tables.py", "read_table"): (2, READER),
    ("cbsr_qa/calibration/presses/number_tables.py", "parquet.ParquetFile"): (1, MEMORY),
    ("cbsr_qa/calibration/presses/tables.py", "read_table"): (2, READER),
    ("cbsr_qa/cli/line.py", "json.loads"): (1, OWN),
    ("cbsr_qa/cli/output.py", "os.fdopen"): (1, OWN),
    ("cbsr_qa/cli/output.py", "os.open"): (2, OWN),
    ("cbsr_qa/cli/serve.py", "webbrowser.open"): (1, NOT_A_FILE),
    ("cbsr_qa/config/documents.py", "source.read_text"): (1, OWN),
    ("cbsr_qa/config/merging.py", "json.loads"): (3, OWN),
    ("cbsr_qa/domain/run/event_documents.py", "json.loads"): (1, OWN),
    ("cbsr_qa/eit/mesh/files.py", "meshio.read"): (1, CHECKED),
    ("cbsr_qa/eit/mesh/files.py", "np.load"): (1, MEMORY),
    ("cbsr_qa/eit/mesh/files.py", "zipfile.ZipFile"): (1, MEMORY),
    ("cbsr_qa/plugin/links/replay.py", "self._links[role].open"): (1, NOT_A_FILE),
    ("cbsr_qa/plugin/links/recorder.py", "self._link.read_bytes"): (1, NOT_A_FILE),
    ("cbsr_qa/plugin/links/visa_link.py", "self._resource.read_bytes"): (1, NOT_A_FILE),
    ("cbsr_qa/plugin/software.py", "distribution(name).read_text"): (1, OWN),
    ("cbsr_qa/report/document.py", "json.loads"): (1, OWN),
    ("cbsr_qa/station/control/lock.py", "Path(f'/proc/{pid}/stat').read_text"): (1, OWN),
    ("cbsr_qa/station/execution.py", "self._desk.open"): (1, NOT_A_FILE),
    ("cbsr_qa/store/archives.py", "h5py.File"): (2, MEMORY),
    ("cbsr_qa/store/archives.py", "os.open"): (1, OWN),
    ("cbsr_qa/store/copies.py", "database.open"): (1, CHECKED),
    ("cbsr_qa/store/copies.py", "partial.open"): (2, OWN),
    ("cbsr_qa/store/copies.py", "sqlite3.connect"): (4, CHECKED),
    ("cbsr_qa/store/chain/many_runs.py", "json.loads"): (1, DATABASE),
    ("cbsr_qa/store/runs/configuration_changes.py", "json.loads"): (2, DATABASE),
    ("cbsr_qa/store/runs/outcomes.py", "json.loads"): (1, DATABASE),
    (
        "cbsr_qa/studies/reproduce/reproduce.py",
        "files('cbsr_qa._stations').joinpath('published', 'ellingham.toml').read_text",
    ): (1, OWN),
    ("cbsr_qa/studies/frontier/stored/study.py", "json.loads"): (1, DATABASE),
    ("cbsr_qa/studies/selection.py", "json.loads"): (2, DATABASE),
    ("cbsr_qa/system/files.py", "os.open"): (3, CHECKED),
    ("cbsr_qa/system/fork_server.py", "os.fdopen"): (2, OWN),
    ("cbsr_qa/system/fork_server.py", "os.open"): (1, OWN),
    ("cbsr_qa/system/fork_server.py", "pickle.load"): (1, OWN),
    ("cbsr_qa/system/fork_server.py", "pickle.loads"): (1, OWN),
    ("cbsr_qa/system/foreign.py", "Path('/proc/self/mountinfo').read_text"): (1, OPENER),
    ("cbsr_qa/system/foreign.py", "os.fdopen"): (1, OPENER),
    ("cbsr_qa/system/foreign.py", "os.open"): (1, OPENER),
    ("cbsr_qa/system/reserve.py", "mmap.mmap"): (1, NOT_A_FILE),
    ("cbsr_qa/system/json_text.py", "json.loads"): (1, OPENER),
    ("cbsr_qa/system/reading_child.py", "Path('/proc/self/statm').read_text"): (1, OWN),
    ("cbsr_qa/system/reading_child.py", "os.fdopen"): (1, OWN),
    ("cbsr_qa/system/reading_child.py", "os.open"): (1, OWN),
    ("cbsr_qa/system/reading_child.py", "pickle.loads"): (1, OWN),
    ("cbsr_qa/system/untrusted.py", "os.fdopen"): (1, OWN),
    ("cbsr_qa/testing/targets.py", "(Path(folder) / 'answered').read_bytes"): (1, OWN),
    ("cbsr_qa/testing/targets.py", "(Path(folder) / 'asked').read_bytes"): (1, OWN),
    ("cbsr_qa/testing/targets.py", "pickle.loads"): (2, OWN),
    ("cbsr_qa/web/application.py", "folder.joinpath(name).read_bytes"): (1, OWN),
    ("cbsr_qa/web/application.py", "line.open"): (1, NOT_A_FILE),
    ("cbsr_qa/web/files.py", "(reports_folder() / report_name(look.serial, look.run)).read_bytes"): (1, OWN),
    ("cbsr_qa/web/processes.py", "self.log.read_text"): (1, OWN),
    ("cbsr_qa/web/server.py", "context.load_cert_chain"): (1, CHECKED),
    ("cbsr_qa/web/texts.py", "files(__package__).joinpath(_FILE).read_text"): (1, OWN),
    ("plugins/cbsr_qa_plugins/sinks/json_lines.py", "os.open"): (1, WRITES),
    ("plugins/cbsr_qa_plugins/sinks/webhook.py", "opener.open"): (1, NOT_A_FILE),
}


def _calls(path: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(path.read_text())):
        if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Attribute | ast.Name):
            continue
        last = node.func.attr if isinstance(node.func, ast.Attribute) else node.func.id
        if last not in LAST_NAMES or _only_writes(node, last):
            continue
        name = ast.unparse(node.func)
        of_module = f"{name.rpartition('.')[0].rpartition('.')[2]}.{last}"
        if last in OPENING or of_module in OPENING:
            yield name


def _only_writes(call: ast.Call, last: str) -> bool:
    if last != "open":
        return False
    modes = [each.value for each in (*call.args, *(k.value for k in call.keywords)) if isinstance(each, ast.Constant)]
    return any(isinstance(mode, str) and mode.startswith(_WRITES) and len(mode) <= 3 for mode in modes)


def test_nothing_is_opened_or_parsed_but_by_the_opener():
    found = Counter(
        (str(path.relative_to(TOP)), name) for root in ROOTS for path in root.rglob("*.py") for name in _calls(path)
    )
    allowed = {call: count for call, (count, _) in ALLOWED.items()}
    new = {call: count for call, count in found.items() if count > allowed.get(call, 0)}
    assert not new, f"open files of others with open_foreign or read_foreign, or list the call with its reason: {new}"
    gone = {call: count for call, count in allowed.items() if found[call] < count}
    assert not gone, f"no longer there: {gone}"


def test_a_call_that_opens_is_found_however_it_is_spelt(tmp_path):
    source = tmp_path / "module.py"
    source.write_text(
        "open(a)\nPath(a).open('rb')\na.open(mode='r+b')\nnp.load(a)\nh5py.File(a)\nos.open(a, f)\na.read_text()\n"
        "json.loads(a)\nimport_module('pyarrow.parquet').read_table(a)\n"
        "a.open('wb')\nopen(a, 'x')\nmodel.load(a)\n"
    )
    assert [name.rpartition(".")[2] for name in _calls(source)] == [
        *("open", "open", "open", "load", "File", "open", "read_text", "loads", "read_table")
    ]
