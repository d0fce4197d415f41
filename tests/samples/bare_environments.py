"""Programs that have only some packages: refused in a process of this environment, or absent from a fresh one."""

import importlib.metadata
import os
import re
import shutil
import subprocess
import sys
import venv
from pathlib import Path

from packaging.requirements import Requirement

TOP = Path(__file__).resolve().parents[2]

#: Optional imports of numpy and scipy find nothing where these are refused, as on a computer without them.
_REFUSING = """
import sys
class OnlyThese:
    def find_spec(self, name, path=None, target=None):
        top = name.partition(".")[0]
        if top not in ALLOWED and not top.startswith("_sysconfigdata"):  # named after the platform
            raise ModuleNotFoundError(f"{name} is not on this computer", name=name)
sys.meta_path.insert(0, OnlyThese())
del OnlyThese
"""
#: Appended to a program: prints the modules of this package that it has loaded.
PRINT_LOADED = "\nprint('loaded', *(name for name in __import__('sys').modules if name.startswith('cbsr_qa.')))"


def read_loaded(printed: str) -> list[str]:
    """Return what :data:`PRINT_LOADED` printed."""
    return printed.partition("loaded ")[2].split()


def list_required(*names: str) -> set[str]:
    """Return distributions and what they require in turn, by normal name."""
    found: set[str] = set()
    waiting = list(names)
    while waiting:
        name = re.sub(r"[-_.]+", "-", waiting.pop()).lower()
        if name not in found:
            found.add(name)
            needed = map(Requirement, importlib.metadata.requires(name) or ())
            waiting += [one.name for one in needed if one.marker is None or one.marker.evaluate({"extra": ""})]
    return found


def run_beside(distributions: tuple[str, ...], code: str, *arguments: object) -> subprocess.CompletedProcess[str]:
    """Run a program that can import ``cbsr_qa``, the standard library, and some distributions with what they need."""
    required = list_required(*distributions)
    imported = {
        module
        for module, owners in importlib.metadata.packages_distributions().items()
        if required & {re.sub(r"[-_.]+", "-", owner).lower() for owner in owners}
    }
    allowed = {"cbsr_qa"} | set(sys.stdlib_module_names) | imported
    program = _REFUSING.replace("ALLOWED", repr(sorted(allowed))) + code
    command = [sys.executable, "-c", program, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False, cwd=TOP)


def build_wheel(folder: Path) -> Path:
    """Build the wheel of a copy of this tree: setuptools leaves things behind where it builds."""
    source = folder / "source"
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=TOP, capture_output=True, text=True, check=True,
    )  # fmt: skip
    for name in filter(None, listed.stdout.split("\0")):
        if (TOP / name).is_file() and not name.startswith(("tests/", "docs/", "benchmarks/")):
            (source / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(TOP / name, source / name)
    _pip("wheel", "--no-deps", "--no-build-isolation", "--no-index", "--wheel-dir", str(folder), str(source))
    shutil.rmtree(source)
    (wheel,) = folder.glob("*.whl")
    return wheel


def make_environment(folder: Path, wheel: Path, *distributions: str) -> Path:
    """Make an environment with the wheel, installed without dependencies, beside some distributions.

    These, with what they need, are linked from this environment, so that no index is asked. Returns its Python.
    """
    venv.create(folder, with_pip=False)
    (site,) = (folder / "lib").glob("python*/site-packages")
    for name in list_required(*distributions):
        distribution = importlib.metadata.distribution(name)
        for entry in {Path(file).parts[0] for file in distribution.files or ()} - {"..", "__pycache__"}:
            (site / entry).symlink_to(Path(str(distribution.locate_file(entry))).resolve())
    python = folder / "bin" / "python"
    _pip("--python", str(python), "install", "--no-deps", "--no-index", str(wheel))
    return python


def list_installed(python: Path) -> set[str]:
    """Return the distributions that an environment holds, by normal name."""
    code = "import importlib.metadata as m; print(*(d.metadata['Name'] for d in m.distributions()))"
    done = subprocess.run([python, "-I", "-c", code], capture_output=True, text=True, check=True)
    return {re.sub(r"[-_.]+", "-", name).lower() for name in done.stdout.split()}


def _pip(*arguments: str) -> None:
    own = {"PIP_CONFIG_FILE": os.devnull, "PIP_DISABLE_PIP_VERSION_CHECK": "1"}
    kept = {name: value for name, value in os.environ.items() if not name.startswith("PIP_")}
    done = subprocess.run(
        [sys.executable, "-m", "pip", *arguments], env=kept | own, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
