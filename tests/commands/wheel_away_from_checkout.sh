#!/usr/bin/env bash
# Build sdist and wheel, install the wheel in a fresh environment, and run the demonstration where no checkout is near.
set -euo pipefail
top=$(cd "$(dirname "$0")/../.." && pwd)
python=${PYTHON:-python3}
away=$(mktemp -d)
trap 'rm -rf "$away"' EXIT

# From a copy: setuptools leaves build/ and egg-info behind in the folder it builds from.
git -C "$top" ls-files -z --cached --others --exclude-standard | (cd "$top" && tar --null -T - -cf -) | (mkdir "$away/source" && tar -C "$away/source" -xf -)
# Without --wheel, the wheel is built from the sdist: that holds what it needs.
"$top/.venv/bin/python" -m build --outdir "$away/dist" "$away/source" >"$away/build.log" 2>&1 || { cat "$away/build.log"; exit 1; }
"$top/.venv/bin/python" -m twine check --strict "$away"/dist/*

"$python" -m venv "$away/venv"
"$away/venv/bin/python" -m pip install --quiet --disable-pip-version-check -c "$top/constraints.txt" "$away"/dist/*.whl
cd "$away"
mkdir home
cd home
"$away/venv/bin/cbsr-qa" --version
"$away/venv/bin/cbsr-qa" plugins list >/dev/null
"$away/venv/bin/python" -m pip install --quiet --disable-pip-version-check -c "$top/constraints.txt" "$(echo "$away"/dist/*.whl)[web]"
(cd "$away" && "$away/venv/bin/python" -c "from cbsr_qa.web.application import Site; from cbsr_qa.web.pages import Pages; from cbsr_qa.web.line import Line
pages = Pages(Line((), None)); Site(pages._line, pages, None); assert 'line.css' in pages.overview(control=True)")
"$away/venv/bin/cbsr-qa" run --station simulated --recipe nine-locations --serial WHEEL-001 --batch wheel --json >run.json
"$away/venv/bin/python" - <<'PY'
import importlib.metadata
import json
import pathlib

told = importlib.metadata.distribution("cbsr-qa")
assert told.metadata["License-Expression"] == "BSD-3-Clause", told.metadata
assert "BSD 3-Clause License" in told.read_text("licenses/LICENSE"), "the licence is in the wheel"

run = json.loads(pathlib.Path("run.json").read_text())
assert run["end"] == "finished", run
for made in ("report", "calibration"):
    assert pathlib.Path(run[made]).is_file(), made
assert sorted(p.name for p in pathlib.Path.cwd().iterdir()) == ["run.json", "var"], "a run writes only to var/"
PY
echo "the wheel works away from the checkout"
