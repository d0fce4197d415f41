"""The gate from the command line: refused before anything is stored, overridden by name, stored and shown again."""

import pytest
from command import cbsr_qa, document, refused, short_recipe
from killing import BEGIN, killed, latest_run, write_files
from stored_lots import judged, store_run

from cbsr_qa.app.gate.gate import ask_before, gate_refusal
from cbsr_qa.app.run.console import Unattended
from cbsr_qa.app.run.request import RunRequest
from cbsr_qa.app.run.run import run_sensor
from cbsr_qa.config.documents import DocumentKind, open_document
from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.plan.gate import GateCheck
from cbsr_qa.domain.results.measurement import Measurement
from cbsr_qa.store.opening import open_store
from cbsr_qa.system.pins import hash_pin

GATE = """[gate]
disk = "refuse"
disk_GB = 1e6
released = "warn"
operator = "refuse"

[[gate.operators]]
name = "Ada"

[[gate.operators]]
name = "Grace"
pin = "{pin}"

[indenter]"""


def write_station(folder, gate, name="mine.toml"):
    """Write the simulated station with a gate; returns its path."""
    text = open_document(DocumentKind.STATION, "simulated").text
    (folder / name).write_text(text.replace("[indenter]", gate, 1))
    return str(folder / name)


@pytest.fixture(scope="module")
def tested(tmp_path_factory):
    """A folder with a run whose full disk was overridden, the options it was made with, and its document."""
    folder = tmp_path_factory.mktemp("gate")
    write_station(folder, GATE.format(pin=hash_pin("4711")))
    recipe = short_recipe(folder, metrics=["centre-of-mass-error"])
    options = ["--station", "mine.toml", "--recipe", recipe, "--serial", "S-1"]
    before = sorted(folder.rglob("*"))
    said = refused(folder, "run", *options, "--operator", "Ada")
    assert "disk: " in said
    assert "--override disk --override-by NAME" in said
    assert sorted(folder.rglob("*")) == before
    override = ["--override", "disk", "--override-by", "Grace", "--override-why", "a second disk is mounted"]
    done = cbsr_qa(folder, "run", *options, "--operator", "Ada", *override, "--json", check=False)
    return folder, options, document(done)


def test_an_override_is_stored_and_shown_in_report_and_document(tested):
    folder, _, run = tested
    answers = {one["check"]: one for one in run["gate"]}
    disk = answers["disk"]
    assert (disk["outcome"], disk["by"], disk["why"]) == ("overridden", "Grace", "a second disk is mounted")
    assert (answers["operator"]["outcome"], answers["released"]["outcome"]) == ("passed", "warned")
    assert any("gate, disk: " in one and "overridden by Grace" in one for one in run["warnings"])
    again = document(cbsr_qa(folder, "report", run["run"], "--json", "--to", "again"))
    assert again["gate"] == run["gate"]
    for page in (folder / run["report"], folder / again["report"]):
        html = page.read_text()
        assert "Checks before the run." in html
        assert "a second disk is mounted" in html
    with open_store(f"sqlite:///{folder / 'var' / 'cbsr-qa.db'}", create=False) as store:
        assert [one.session for one in store.runs.load(run["run"]).gate] == [0] * len(run["gate"])
        assert "scrypt" not in store.runs.read_configuration(run["run"])


def test_the_gate_and_a_dry_run_give_the_same_answers(tested):
    folder, options, _ = tested
    shown = cbsr_qa(folder, "gate", *options, "--operator", "Grace", "--json", check=False)
    dry = cbsr_qa(folder, "run", *options, "--operator", "Grace", "--dry-run", "--json", check=False)
    assert (shown.returncode, dry.returncode) == (2, 2)
    assert document(shown)["answers"] == document(dry)["gate"]
    assert document(shown)["refused"] == document(dry)["refused"]
    listed = cbsr_qa(folder, "gate", *options, "--operator", "Eve", check=False)
    assert "Eve is not on the list of operators" in " ".join(listed.stdout.split())
    assert cbsr_qa(folder, "gate", "--station", "simulated", *options[2:]).returncode == 0


def test_a_release_is_stored_by_name(tested):
    folder, options, _ = tested
    released = document(cbsr_qa(folder, "release", options[3], "--by", "Grace", "--why", "qualified", "--json"))
    assert (released["kind"], released["action"], released["before"]) == ("recipe", "released", None)
    shown = document(cbsr_qa(folder, "gate", *options, "--json", check=False))
    words = next(one["words"] for one in shown["answers"] if one["check"] == "released")
    assert "recipe" not in words


@pytest.mark.rest
def test_a_resumed_run_is_asked_again_what_matters_by_the_present_station_file(tmp_path):
    write_files(tmp_path)
    gate = '[gate]\noperator = "refuse"\n[[gate.operators]]\nname = "{}"\n\n[indenter]'
    for name in ("Ada", "Grace"):
        write_station(tmp_path, gate.format(name), f"{name}.toml")
    options = [*BEGIN, "--station", "Ada.toml", "--serial", "S-1", "--operator", "Ada"]
    assert killed(tmp_path, options, documents=40, after_s=0.0)
    again = ["run", "--resume", latest_run(tmp_path, "S-1"), "--json", "--operator"]
    assert "--station" in refused(tmp_path, *again, "Ada")
    assert "is of 'bench-emulated'" in refused(tmp_path, *again, "Ada", "--station", "bench-emulated")
    assert "Ada is not on the list" in refused(tmp_path, *again, "Ada", "--station", "Grace.toml")
    done = document(cbsr_qa(tmp_path, *again, "Grace", "--station", "Grace.toml", check=False))
    assert {one["check"] for one in done["gate"] if one["session"] == 1} == {"calibration_due", "disk", "operator"}
    assert len([one for one in done["gate"] if one["session"] == 0]) == len(GateCheck)
    assert "Asked again before resumption 1 of the run." in (tmp_path / done["report"]).read_text()


def test_files_that_change_while_the_pin_is_asked_for_are_refused(tmp_path, monkeypatch):
    monkeypatch.setenv("CBSR_QA_VAR", str(tmp_path / "var"))
    gate = GATE.format(pin=hash_pin("4711")).replace('disk = "refuse"\ndisk_GB = 1e6\n', "")
    station = write_station(tmp_path, gate)
    recipe = tmp_path / short_recipe(tmp_path, metrics=["centre-of-mass-error"])

    class Typing(Unattended):
        def read_pin(self, text):
            recipe.write_text(recipe.read_text().replace("upper = 6.5", "upper = 65"))
            return "4711"

    request = RunRequest(station=station, recipe=str(recipe), serial="S-1", operator="Grace")
    with pytest.raises(RefusedError, match="files of this run were changed while the gate was asked"):
        run_sensor(request, Typing())
    assert not list(tmp_path.rglob("*.db"))


class Watching(Unattended):
    def __init__(self):
        self.told = []

    def tell(self, activity):
        self.told.append(activity)


def test_of_two_runs_of_a_sensor_that_begin_together_one_is_refused_as_a_retest(tmp_path, monkeypatch):
    monkeypatch.setenv("CBSR_QA_VAR", str(tmp_path / "var"))
    station = write_station(tmp_path, '[gate]\nretest = "refuse"\n\n[indenter]')
    recipe = short_recipe(tmp_path, metrics=["centre-of-mass-error"])
    request = RunRequest(station=station, recipe=str(tmp_path / recipe), serial="S-1")
    name = request.configuration(0).recipe.name
    watching = Watching()
    with open_store(f"sqlite:///{tmp_path / 'var' / 'cbsr-qa.db'}") as store:
        with store.claims.claim_sensor("S-1", name, "Ada") as nobody:
            assert nobody == ""
            with pytest.raises(RefusedError, match=f"S-1 is being tested with {name} now, by Ada on "):
                run_sensor(request, watching)

        def passed_meanwhile(*arguments):
            answers = ask_before(*arguments)
            assert gate_refusal(answers) is None
            store_run(store, "S-1", judged((Measurement("drift", 0.1, "%/min"),)), recipe=name)
            return answers

        monkeypatch.setattr("cbsr_qa.app.run.run.ask_before", passed_meanwhile)
        with pytest.raises(RefusedError, match=f"S-1 already passed {name}"):
            run_sensor(request, watching)
        assert "running the station" not in watching.told
        assert len(store.lists.read_runs()) == 1
