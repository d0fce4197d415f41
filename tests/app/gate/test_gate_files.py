"""The tables of the gate: every mistake of a file in one pass, and nothing of a PIN in what is stored or said."""

import pytest

from cbsr_qa.config.loader import load_material, load_recipe, load_sensor_type, load_station
from cbsr_qa.config.merging import merge
from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.plan.gate import GateCheck, GatePolicy
from cbsr_qa.system.pins import hash_pin


def station(folder, gate, head=""):
    text = load_station("simulated").document.text.replace("[indenter]", f"{head}\n{gate}\n[indenter]", 1)
    file = folder / "mine.toml"
    file.write_text(text)
    return str(file)


def test_a_station_of_today_checks_what_it_did():
    gate = load_station("simulated").value.gate
    on = {check: gate.policy(check) for check in GateCheck if gate.policy(check) is not GatePolicy.OFF}
    assert on == {
        GateCheck.SERIAL_PATTERN: GatePolicy.REFUSE,
        GateCheck.PARTS: GatePolicy.WARN,
        GateCheck.CALIBRATION_DUE: GatePolicy.WARN,
        GateCheck.BEFORE_RUN: GatePolicy.REFUSE,
    }


def test_the_earlier_spelling_works_and_both_are_refused(tmp_path):
    old = 'overdue = "refuse"\n'
    gate = load_station(station(tmp_path, "", old)).value.gate
    assert gate.policy(GateCheck.CALIBRATION_DUE) is GatePolicy.REFUSE
    with pytest.raises(ConfigError, match="its earlier spelling"):
        load_station(station(tmp_path, '[gate]\ncalibration_due = "warn"', old))


def test_every_mistake_is_named_in_one_pass_and_no_pin(tmp_path):
    gate = """[gate]
retest = "maybe"
golden = "refuse"
golden_hour = 3
disk_GB = -1
operator = "refuse"
[[gate.operators]]
name = "Ada"
pin = "4711"
[[gate.operators]]
name = "Ada"
pin = 8899
"""
    with pytest.raises(ConfigError) as refused:
        load_station(station(tmp_path, gate))
    said = str(refused.value)
    assert "mine.toml line" in said
    for named in ("gate.retest", "gate.golden needs", "golden_hour", "gate.disk_GB", "is listed before"):
        assert named in said
    assert said.count("is no hash of a PIN") == 2
    assert "4711" not in said
    assert "8899" not in said


def test_operators_change_no_digest_and_their_pins_are_not_stored(tmp_path):
    parts = load_recipe("nine-locations"), load_sensor_type("disc-100mm"), load_material("cbsr-8wt")
    digests = set()
    for name in ("Ada", "Grace"):
        gate = f'[gate]\noperator = "refuse"\n[[gate.operators]]\nname = "{name}"\npin = "{hash_pin("4711")}"'
        at = load_station(station(tmp_path, gate))
        assert at.value.gate.operators[0].name == name
        merged = merge(at, *parts, seed=1)
        digests.add(merged.digest)
        assert "scrypt" not in merged.canonical
    assert len(digests) == 1


@pytest.mark.parametrize("pattern", ["(", "(?=a)", "", "a" * 201, "((a{1000}){1000})"])
def test_a_pattern_that_cannot_be_used_is_refused_with_the_file(tmp_path, pattern):
    text = load_sensor_type("disc-100mm").document.text
    file = tmp_path / "type.toml"
    file.write_text(text.replace("[sensor_type]", f"[sensor_type]\nserial_pattern = '{pattern}'", 1))
    with pytest.raises(ConfigError, match=r"line \d+: sensor_type.serial_pattern"):
        load_sensor_type(file)


@pytest.mark.parametrize(
    ("tables", "said"),
    [
        ('[gate]\nbacklog = "warn"', "needs backlog_hours in [sync]"),
        ('[sync]\ncentre = "quality.db"', "'quality.db' is no URL"),
        ('[sync]\ncentre = "postgresql://ada:hidden-word@10.0.0.5/quality"', "has a password in it"),
        ('[sync]\ncentre = "postgresql://10.0.0.5/quality?password=hidden-word"', "has a password in it"),
        ("[sync]\nbacklog_hours = 0", "sync.backlog_hours is 0"),
    ],
)
def test_a_table_of_the_synchronisation_that_cannot_be_used_is_named_without_its_password(tmp_path, tables, said):
    with pytest.raises(ConfigError) as caught:
        load_station(station(tmp_path, tables))
    assert said in str(caught.value)
    assert "hidden-word" not in str(caught.value)
