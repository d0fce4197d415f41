"""The PIN that a line asks for before the first scan."""

import io
import sys

import pytest

from cbsr_qa.cli.line import line
from cbsr_qa.config.documents import DocumentKind, open_document
from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.system.pins import hash_pin

_GATE = '[gate]\noperator = "refuse"\n[[gate.operators]]\nname = "Ada"\npin = "{pin}"\n\n[indenter]'


@pytest.mark.parametrize("pin", ["4712", ""])
def test_a_wrong_pin_is_refused_before_the_first_scan(tmp_path, monkeypatch, pin):
    station = open_document(DocumentKind.STATION, "simulated").text
    file = tmp_path / "station.toml"
    file.write_text(station.replace("[indenter]", _GATE.format(pin=hash_pin("4711")), 1))
    monkeypatch.setattr(sys, "stdin", io.StringIO(f"{pin}\nS-1\n"))
    with pytest.raises(RefusedError, match="the PIN given is not that of Ada"):
        line(str(file), "nine-locations", operator="Ada")
