"""Halves of characters, as undecodable file names and damaged files have them, are shown escaped or refused."""

import io
import json
import os
import sys

import numpy as np
import pytest

from cbsr_qa.cli.main import run_guarded
from cbsr_qa.cli.output import emit_json, say
from cbsr_qa.domain.errors import RefusedError, StoreError
from cbsr_qa.domain.readings.frames import SampleBlock
from cbsr_qa.domain.results.measurement import Measurement
from cbsr_qa.store.opening import open_store
from cbsr_qa.store.types import PlainText

HALF = "a\udcffb"


@pytest.mark.parametrize("encoding", ["utf-8", "ascii", "latin-1"])
def test_what_stdout_cannot_encode_is_escaped(monkeypatch, encoding):
    raw = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(raw, encoding=encoding))
    emit_json({"file": HALF, "unit": "µ☃"})
    said = raw.getvalue()
    say(f"{HALF} µ☃")
    assert json.loads(said.decode(encoding)) == {"file": HALF, "unit": "µ☃"}
    assert rb"a\udcffb " in raw.getvalue()[len(said) :]


@pytest.mark.parametrize("name", ["name", "unit", "phase", "location", "qualifier", "how"])
def test_a_measurement_is_refused(name):
    with pytest.raises(RefusedError, match=r"is 'a\\udcffb'"):
        Measurement(**{"name": "force", "value": 1.0, "unit": "N", name: HALF})


@pytest.mark.parametrize("texts", [(HALF, "N"), ("force", HALF)])
def test_a_channel_is_refused(texts):
    with pytest.raises(RefusedError, match=r"is 'a\\udcffb'"):
        SampleBlock(*texts, np.zeros(1), np.zeros(1))


def test_what_an_instrument_says_is_stored_without_them():
    assert PlainText().process_bind_param("\0x\ud800", None) == "\ufffdx\ufffd"


@pytest.mark.parametrize("where", [f"/tmp/{HALF}.db", f"sqlite:////tmp/{HALF}.db", f"postgresql://u:{HALF}@h/d"])
def test_a_database_of_such_a_name_is_refused(where, capsys):
    assert run_guarded(["db", "upgrade", "--database", where, "--json"]) == 2
    assert "the database URL cannot be read" in json.loads(capsys.readouterr().out)["refused"]["reason"]


def test_what_is_looked_for_in_a_database_is_refused_or_not_found(tmp_path):
    with open_store(f"sqlite:///{tmp_path / 'runs.db'}") as store, pytest.raises(StoreError, match="udcff"):
        store.runs.resolve(os.fsdecode(b"a\xffb"))
