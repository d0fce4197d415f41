"""What the documentation tells a user to type is typed here, and its snippets are run."""

import html
import json
import re
import shlex
import shutil
import subprocess
import tomllib
from types import SimpleNamespace

import numpy as np
import pytest
from demo_fleet import demo_fleet
from pages import HOW_TO, SHORTENED, TOP, TYPED, assert_printed, blocks, commands, typed, write_files

import cbsr_qa as qa
from cbsr_qa.cli import command as cli
from cbsr_qa.domain.readings.frames import SampleBlock
from cbsr_qa.domain.sensor.patterns import adjacent_pattern
from cbsr_qa.eit.forward.closed_forms import ring_readings
from cbsr_qa.studies.fleet_demo import SAID
from cbsr_qa_plugins.sequences.places import GivenLoadsSequence

_PAGES = sorted([TOP / "README.md", *(TOP / "docs").rglob("*.md")])


def test_commands_that_are_shown_exist():
    known = {command.words for command in cli.commands()} | {name for name, word in cli._DEFAULTS.items() if word}
    for page in _PAGES:
        for command in commands(page):
            program, *words = shlex.split(command)
            if program == "cbsr-qa" and not words[0].startswith("--"):
                assert not known.isdisjoint((words[0], " ".join(words[:2]))), f"{page.name}: {command}"


@pytest.mark.rest
def test_the_tour_of_the_readme_runs_as_printed(tmp_path, monkeypatch, capsys):
    export, first, *others = commands(TOP / "README.md")
    assert len(others) >= 8
    assert export.startswith("export PATH")
    assert typed(tmp_path, first, fresh=True).stdout.strip()
    for command in others:
        assert typed(tmp_path, command).stdout.strip(), command
    assert [path.name for path in tmp_path.iterdir()] == ["var"]
    monkeypatch.chdir(tmp_path)
    (snippet,) = blocks(TOP / "README.md", "python")
    exec(snippet, {})
    assert re.fullmatch(
        r"up to \d\.\d\d N; errors include scatter only; load cell not stated\n", capsys.readouterr().out
    )


@pytest.mark.rest
def test_the_page_on_installing_types_the_run_of_the_tour(tmp_path):
    (run,) = commands(HOW_TO / "install.md")
    tour = commands(TOP / "README.md")[2]
    assert run.replace("DEMO-001", "TOUR-1") in tour  # which is typed there
    assert "station time" in typed(tmp_path, f"{run} --dry-run").stdout


@pytest.mark.rest
def test_the_page_on_ones_own_sensor_runs_as_printed(tmp_path, monkeypatch):
    page = HOW_TO / "describe-a-sensor.md"
    assert len(write_files(page, tmp_path)) == 3
    monkeypatch.chdir(tmp_path)
    exec("\n".join(blocks(page, "python")), {})
    for command in commands(page):
        typed(tmp_path, command)
    (report,) = (tmp_path / "var" / "reports").glob("E-1*.html")
    assert "polygon of 6 corners rounded with 4 mm, 80 mm × 80 mm" in report.read_text()


@pytest.mark.rest
def test_the_page_on_ones_own_data_runs_as_printed(tmp_path, monkeypatch):
    """With the tables of the page that it names."""
    tables = HOW_TO / "calibrate-from-presses.md"
    write_files(tables, tmp_path)
    monkeypatch.chdir(tmp_path)
    exec(blocks(tables, "python")[0], {})
    page = HOW_TO / "bring-your-own-data.md"
    imaged, calibrated = [typed(tmp_path, command).stdout for command in commands(page)]
    assert "100 events found" in imaged
    assert "100 used, 0 left out" in calibrated
    namespace = {}
    (notebook,) = blocks(page, "python")
    exec(notebook, namespace)
    assert namespace["images"].values.shape[0] == len(namespace["events"]) == 100
    assert (tmp_path / "images.html").exists()


@pytest.mark.rest
def test_the_page_on_scenes_runs_as_printed(tmp_path):
    page = HOW_TO / "simulate-a-scene.md"
    assert len(write_files(page, tmp_path)) == 1
    for command in commands(page):
        assert typed(tmp_path, command).stdout.strip(), command
    assert {path.name for path in (tmp_path / "var" / "scenes").iterdir()} == {
        "faulty-electrode-seed3.h5",
        "two-heads-seed7.h5",
        "two-heads-seed7.ert-board-csv.csv",
    }


@pytest.mark.rest
def test_the_page_on_signing_runs_as_printed(tmp_path):
    page = HOW_TO / "sign-runs.md"
    make, export = (block.strip() for block in blocks(page, "sh"))
    subprocess.run(["bash", "-c", make], cwd=tmp_path, check=True)
    assert (tmp_path / "cbsr-qa.key").stat().st_mode & 0o077 == 0
    name, value = export.removeprefix("export ").split("=")
    tested, reported = (typed(tmp_path, line, check=False, **{name: value}) for line in commands(page))
    chain = json.loads(reported.stdout)["chain"]
    assert f"chained by digests and signed (key {chain['key_id']})" in tested.stdout
    assert chain | {"key_id": ""} == {"state": "chained", "signature": "checked", "key_id": ""}
    secret = (tmp_path / "cbsr-qa.key").read_text().strip()
    written = [path for path in (tmp_path / "var").rglob("*") if path.is_file()]
    assert len(written) >= 2
    assert not any(secret.encode() in path.read_bytes() for path in written)
    assert secret not in tested.stdout + tested.stderr + reported.stdout + reported.stderr


@pytest.mark.rest
def test_the_page_on_fielded_sensors_runs_as_printed(tmp_path):
    for command in commands(HOW_TO / "verify-a-fielded-sensor.md"):
        done = typed(tmp_path, command)
    assert "PASS" in done.stdout
    assert "has no phase to calibrate from" in done.stdout
    assert len(list((tmp_path / "var" / "calibrations").iterdir())) == 1


def test_the_page_on_bringing_up_a_station_runs_as_printed(tmp_path):
    page = HOW_TO / "bring-up-a-station.md"
    for command in commands(page):
        assert "✓ OK" in typed(tmp_path, command).stdout, command
    ring = ring_readings([1e4] * 16, adjacent_pattern(16))
    assert (ring[0, 0], round(ring[0, 5])) == (9375.0, -625)
    assert "9.375 kΩ and −625 Ω for 16 of 10 kΩ" in " ".join(page.read_text().split())


@pytest.mark.rest
def test_the_page_on_choosing_a_recipe_prints_what_is_chosen_and_tries_it(tmp_path):
    shown, chosen, tried = commands(HOW_TO / "choose-a-recipe.md")
    assert chosen.startswith(shown)  # the same table, and what is chosen from it
    for command in (chosen, tried):
        done = typed(tmp_path, command)
        assert done.stdout.strip(), command
    assert "station time" in done.stdout
    assert (tmp_path / "chosen.toml").exists()


@pytest.mark.rest
def test_the_page_on_comparing_batches_shows_what_is_printed(tmp_path):
    page = HOW_TO / "compare-batches.md"
    build, *comparisons = commands(page)
    assert build == "python -m cbsr_qa.cli.studies.fleet_demo"
    (tmp_path / "var").mkdir()
    shutil.copy(demo_fleet()[0], tmp_path / "var")
    shown = blocks(page, "text")
    assert len(shown) == len(comparisons) == 4
    for command, lines in zip(comparisons, shown, strict=True):
        words = shlex.split(command)
        printed = " ".join(typed(tmp_path, command).stdout.split())
        begins = printed.index(" ".join(lines.split()))
        assert (begins == 0) is {"--margin", "--distribution"}.isdisjoint(words)  # the page shows their tables alone
        written = (tmp_path / words[words.index("--output") + 1]).read_text()
        plain = " ".join(html.unescape(re.sub(r"<[^>]*>", " ", written)).split())
        assert printed[: printed.index(" compared by")].removeprefix("● ") in plain
        assert SAID in plain


def test_every_page_with_commands_is_typed_somewhere():
    shown = {str(page.relative_to(TOP)) for page in _PAGES if commands(page)}
    assert shown == {*TYPED, *SHORTENED}
    for page, test in TYPED.items():
        assert page.rsplit("/", 1)[-1] in (TOP / "tests" / test).read_text(), f"{test} does not read {page}"


def test_the_page_on_building_a_bench_runs_as_printed(tmp_path):
    (command,) = commands(HOW_TO / "build-this-bench.md")
    assert "station time" in typed(tmp_path, command).stdout


@pytest.mark.rest
def test_the_page_on_recordings_images_with_another_method(tmp_path):
    (command,) = commands(TOP / "docs" / "reference" / "recordings.md")
    typed(tmp_path, "cbsr-qa scene run faulty-electrode --output shown.h5")
    assert "temporal" in typed(tmp_path, command.replace(" FILE ", " shown.h5 ")).stdout


@pytest.mark.parametrize("page", _PAGES, ids=lambda page: page.name)
def test_links_between_pages_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", page.read_text()):
        if not target.startswith(("http://", "https://")):
            assert (page.parent / target).exists(), target


@pytest.mark.parametrize("page", _PAGES, ids=lambda page: page.name)
def test_toml_snippets_are_toml(page):
    for block in blocks(page, "toml"):
        tomllib.loads(block)


def test_the_metric_of_the_plugin_page_measures():
    namespace = {}
    for block in blocks(HOW_TO / "write-a-plugin.md", "python"):
        exec(block, namespace)
    registered = []
    namespace["cbsr_register"](lambda *registration: registered.append(registration))
    assert [name for _, name, _ in registered] == ["peak-force"]

    force = SampleBlock("force", "N", np.arange(3.0), np.array([0.0, 4.5, 1.0]))
    phases = [SimpleNamespace(channel=lambda name: None), SimpleNamespace(channel=lambda name: force)]
    metric = namespace["PeakForce"]()
    (peak,) = metric.measure_run(SimpleNamespace(record=SimpleNamespace(phases=phases)))
    assert (peak.value, peak.unit) == (4.5, "N")
    (nothing,) = metric.measure_run(SimpleNamespace(record=SimpleNamespace(phases=phases[:1])))
    assert nothing.value is None


def test_the_reconstruction_of_the_plugin_page_conforms(capsys):
    namespace = {}
    for block in blocks(HOW_TO / "write-a-plugin.md", "python"):
        exec(block, namespace)
    said = capsys.readouterr().out.splitlines()
    assert len(said) == 10
    assert said[-1].startswith("refusals: NaN")


def test_the_sheet_of_the_forward_model_page_is_pressed():
    namespace = {}
    for block in blocks(TOP / "docs" / "explanation" / "forward-model.md", "python"):
        exec(block, namespace)
    unloaded, pressed = namespace["sheet"].voltages(), namespace["pressed"]
    assert pressed.shape == unloaded.shape == (16, 16)
    assert (np.diag(pressed) < np.diag(unloaded)).all()  # it conducts better everywhere


_RUN_ABOVE = {"write-a-plugin.md", "describe-a-sensor.md", "forward-model.md", "reconstruction.md"}
_RUN_ABOVE |= {"your-first-plugin.md"}  # by test_plugin_tutorial.py
_RUN_ABOVE |= {
    "use-in-a-robot.md",
    "use-the-eit-engine.md",
    "sign-calibrations.md",
    "issue-a-certificate.md",
    "stream-forces.md",
    "calibration-file.md",
    "bring-your-own-data.md",
    "calibrate-from-presses.md",
    "take-your-data-elsewhere.md",
    "first-sensor-in-a-notebook.md",
    "python.md",
    "README.md",
}  # on a file that is made for them


@pytest.mark.parametrize(
    "page",
    [page for page in _PAGES if page.name not in _RUN_ABOVE and blocks(page, "python")],
    ids=lambda page: page.name,
)
def test_snippets_of_all_other_pages_run(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    namespace = {}
    for block in blocks(page, "python"):
        exec(block, namespace)


_NUMBER = re.compile(r"\d+(?:\.\d+)?")


@pytest.mark.rest
def test_the_numbers_of_the_reconstruction_page_are_what_its_snippets_print(capsys):
    page = TOP / "docs" / "explanation" / "reconstruction.md"
    snippets = re.findall(r"^```python\n(.*?)^```\n\n```text\n(.*?)^```", page.read_text(), re.M | re.S)
    assert len(snippets) == len(blocks(page, "python")) == 7
    namespace = {}
    for snippet, shown in snippets:
        exec(snippet, namespace)
        printed = capsys.readouterr().out
        assert _NUMBER.sub("#", " ".join(printed.split())) == _NUMBER.sub("#", " ".join(shown.split()))
        for stated, computed in zip(_NUMBER.findall(shown), _NUMBER.findall(printed), strict=True):
            last = 10.0 ** -len(computed.partition(".")[2])  # a digit may round either way
            assert float(stated) == pytest.approx(float(computed), rel=0.05, abs=1.01 * last), (stated, computed)


def test_the_reconstruction_page_states_no_number_that_nothing_computes():
    page = (TOP / "docs" / "explanation" / "reconstruction.md").read_text()
    printed = set(_NUMBER.findall("".join(re.findall(r"^```(?:text|python)\n(.*?)^```", page, re.M | re.S))))
    prose = re.sub(r"^```.*?^```", "", page, flags=re.M | re.S)
    prose = re.sub(r"`[^`]*`|\([A-Z][^()]*(?:19|20)\d\d\)|et al\. \d{4}", "", prose)  # options and sources
    stated = {number for number in _NUMBER.findall(prose) if float(number) > 10}
    assert "2025" in stated
    assert stated <= printed, stated - printed


def test_the_page_on_the_paper_shows_loads_that_can_be_pressed():
    page = HOW_TO / "reproduce-the-paper.md"
    (block,) = blocks(page, "toml")
    options = tomllib.loads(block)
    assert options.pop("sequence") == "given-loads"
    assert GivenLoadsSequence(**options)


@pytest.mark.rest
def test_the_page_on_presses_runs_as_printed(tmp_path, monkeypatch):
    page = HOW_TO / "calibrate-from-presses.md"
    assert write_files(page, tmp_path) == ["skin.toml"]
    monkeypatch.chdir(tmp_path)
    simulated, used = blocks(page, "python")
    exec(simulated, {})
    calibrated, shown, _, applied = (typed(tmp_path, command).stdout for command in commands(page)[:4])
    in_python = {}
    exec(used, in_python)
    assert in_python["radius_mm"].max() < 1
    assert in_python["flags"][0] == qa.Flag(0)
    untouched = in_python["calibration"].places(np.zeros((1, in_python["frames"].shape[1])))
    assert np.isnan(in_python["calibration"].force(untouched).values).all()
    assert qa.Flag.NOT_DETECTED in qa.Flag(int(untouched.flags[0]))
    with pytest.raises(qa.CbsrError, match="load_calibration"):
        qa.Calibration.load("skin.h5")
    assert qa.load_calibration("skin.h5").lacks["depth"] == "was learned from presses that had no depth"
    with pytest.raises(qa.CbsrError, match="no depth"):
        in_python["calibration"].depth(in_python["places"])
    # One press more or less inside its region is another whole percent.
    assert_printed(re.sub(r"\d+ % \(asked", "… % (asked", blocks(page, "text")[0]), calibrated)
    assert "no station made this" in shown
    frames = json.loads(applied)["frames"]
    labels = np.loadtxt(tmp_path / "later-presses.csv", delimiter=",", skiprows=1)
    found = np.array([(frame["x_mm"], frame["y_mm"]) for frame in frames])
    assert np.linalg.norm(found - labels[:, :2], axis=1).mean() < 1
    assert np.abs(in_python["force"].values - labels[:, 2]).mean() < 0.2
    assert len((tmp_path / "places.csv").read_text().splitlines()) == 1 + len(labels)
    assert "100 presses left out" in (tmp_path / "skin.html").read_text()


@pytest.mark.rest
def test_the_page_on_presses_says_how_many_are_enough(tmp_path, monkeypatch):
    page = HOW_TO / "calibrate-from-presses.md"
    write_files(page, tmp_path)
    monkeypatch.chdir(tmp_path)
    exec(blocks(page, "python")[0], {})
    *_, sweep = commands(page)
    printed = typed(tmp_path, sweep, limit_s=1200).stdout  # 30 s of one core
    assert "the fewest of 4 numbers that were tried" in " ".join(printed.split())
