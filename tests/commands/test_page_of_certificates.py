"""The page on certificates, typed as printed, and what a robot is told to do with them."""

import json
import shutil

import pytest
from pages import HOW_TO, blocks, commands, typed, write_files

_PAGE = HOW_TO / "issue-a-certificate.md"

pytestmark = pytest.mark.rest


def test_the_page_runs_as_printed(tmp_path, monkeypatch):
    assert write_files(_PAGE, tmp_path) == ["laboratory.toml"]
    run, keygen, issue, verify, replace, revoke, listing, withdrawn = commands(_PAGE)
    for line in (run, keygen, issue):
        typed(tmp_path, line)
    folder = tmp_path / "certificates"
    (number,) = (path.stem for path in folder.glob("*.html"))
    assert number.startswith("SSW-")
    for name in (f"{number}.signature.json", "station.key.pub"):
        assert ((folder if "json" in name else tmp_path) / name).exists()
    for line in (verify, replace, revoke, listing, withdrawn):
        typed(tmp_path, line.replace("SSW-…", number))
    gone = typed(tmp_path, f"{verify.replace('SSW-…', number)} --json", check=False)
    assert gone.returncode == 1
    assert f"was replaced by certificate {number}-R1" in json.loads(gone.stdout)["why"]
    assert [one["number"] for one in json.loads((tmp_path / "withdrawn.json").read_text())["withdrawn"]] == [
        number,
        f"{number}-R1",
    ]
    (issued,) = (tmp_path / "var" / "calibrations").glob("*.h5")
    shutil.copy(issued, tmp_path / "sensor.h5")
    shutil.copy(folder / f"{number}-R1.signature.json", tmp_path / "sensor.signature.json")
    monkeypatch.chdir(tmp_path)
    (snippet,) = blocks(_PAGE, "python")
    with pytest.raises(Exception, match=f"certificate {number}-R1 of this calibration was revoked"):
        exec(snippet, {})
    exec(snippet.replace('    withdrawn="withdrawn.json",\n', ""), {})
