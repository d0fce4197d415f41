"""A whole run tells a file and a server what happens; a server that is not there changes nothing but a warning."""

import json
import socket

import pytest
from command import cbsr_qa, refused
from killing import BEGIN, write_files

_SINKS = """
[events.log]
sink = "json-lines"
path = "{{serial}}.jsonl"

[events.office]
sink = "webhook"
url = "http://127.0.0.1:{port}/events"
"""


@pytest.mark.rest
def test_a_run_is_told_in_full_and_waits_for_nobody(tmp_path):
    write_files(tmp_path)
    with socket.socket() as nobody:
        nobody.bind(("127.0.0.1", 0))
        with (tmp_path / "station.toml").open("a") as station:
            station.write(_SINKS.format(port=nobody.getsockname()[1]))
        outcome = json.loads(cbsr_qa(tmp_path, *BEGIN, "--serial", "S-1").stdout)
    messages = [json.loads(line) for line in (tmp_path / "var" / "S-1.jsonl").read_text().splitlines()]
    assert [message["number"] for message in messages] == list(range(len(messages)))
    types = [message["event"]["type"] for message in messages]
    assert (types[0], types[-2:], types.count("load_finished")) == ("run_started", ["run_ended", "run_concluded"], 6)
    assert {message["run"] for message in messages} == {outcome["run"]}
    assert messages[-2]["event"]["end"] == "finished"
    concluded = {key: outcome[key] for key in ("end", "outcome", "reason", "report", "calibration")}
    told = {key: value for key, value in concluded.items() if value is not None}
    assert messages[-1]["event"] == {"type": "run_concluded", **told}
    (lost,) = [warning for warning in outcome["warnings"] if "events" in warning]
    everything = len(messages) - 1  # of the verdict a report that holds it cannot say whether it was lost
    assert lost.startswith(
        f"events 'office' (webhook): {everything} of {everything} events were not delivered: http://"
    )


def test_a_wrong_table_is_refused_with_its_line(tmp_path):
    write_files(tmp_path)
    station = (tmp_path / "station.toml").read_text()
    (tmp_path / "station.toml").write_text(station + '\n[events.plant]\nsink = "mqtt"\ntopic = "a/{operator}"\n')
    said = refused(tmp_path, *BEGIN, "--serial", "S-1")
    line = len(station.splitlines()) + 4
    assert f"station.toml line {line}: events.plant.topic is 'a/{{operator}}'; it may have the fields" in said
    assert "events.plant.host is missing" in said
    assert not (tmp_path / "var").exists()
