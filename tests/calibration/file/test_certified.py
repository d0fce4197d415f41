"""Signature files of certificates, lists of withdrawn ones, and calibrations that are refused with them."""

import json
from dataclasses import replace
from datetime import date, timedelta

import pytest
from calibration_samples import sparse_calibration
from force_calibration import force_calibration
from signed_samples import AT, made_key

import cbsr_qa as qa
from cbsr_qa.calibration.file.certified import (
    CertificateSeal,
    Withdrawn,
    WithdrawnList,
    check_certified,
    check_sealed,
    read_seal,
    read_withdrawn,
    sign,
    to_text,
)
from cbsr_qa.calibration.file.hdf5 import stamp, write_calibration
from cbsr_qa.calibration.file.keys import signing_key
from cbsr_qa.domain.errors import CalibrationError

DIGEST = 64 * "c"
SEAL = CertificateSeal("SSW-1", "S-1", DIGEST, "2027-11-21", 64 * "a", 64 * "b")
IN_TIME, LATE = date(2027, 11, 21), date(2027, 11, 22)


@pytest.fixture
def key(tmp_path):
    return made_key(tmp_path)


def written(folder, name, content):
    path = folder / name
    path.write_text(to_text(content))
    return path


@pytest.fixture
def seal(tmp_path, key):
    return written(tmp_path, "SSW-1.signature.json", sign(SEAL, signing_key(key), AT))


@pytest.fixture
def revoked(tmp_path, key):
    entry = Withdrawn("SSW-1", DIGEST, "revoked on 2027-01-02 by Ada: wrong head")
    return written(tmp_path, "withdrawn.json", sign(WithdrawnList((entry,)), signing_key(key), AT))


def check(certificate=None, withdrawn=None, *, digest=DIGEST, public_key=None, today=IN_TIME):
    check_certified(digest, certificate, withdrawn, public_key=public_key, today=today)


def test_a_seal_comes_back_and_fits_its_key(seal, key):
    content = read_seal(seal)
    assert replace(content, public_key="", signed_at="", signature="") == SEAL
    check_sealed(seal, content, f"{key}.pub")
    check(seal, public_key=f"{key}.pub")


@pytest.mark.parametrize(
    "field", ["number", "serial", "calibration_digest", "valid_until", "html_sha256", "dcc_sha256"]
)
def test_every_field_is_signed(seal, field):
    content = json.loads(seal.read_text())
    content[field] = "2099-01-01" if field == "valid_until" else content[field][:-1] + "9"
    seal.write_text(json.dumps(content))
    with pytest.raises(CalibrationError, match="does not fit: it was changed"):
        check_sealed(seal, read_seal(seal), None)


def test_another_key_and_no_signature_are_refused(seal, tmp_path):
    other = made_key(tmp_path, "b.key")
    with pytest.raises(CalibrationError, match="not by the pinned key"):
        check(seal, public_key=f"{other}.pub")
    with pytest.raises(CalibrationError, match="is not signed"):
        check(written(tmp_path, "bare.json", SEAL))


def test_a_certificate_lapses_after_its_last_day(seal):
    check(seal, today=IN_TIME)
    with pytest.raises(CalibrationError, match=r"certificate SSW-1 lapsed: it was valid until 2027-11-21"):
        check(seal, today=LATE)


def test_a_clock_before_the_signature_is_named(seal, revoked):
    """A computer without a battery begins in 1970: nothing would lapse there."""
    early = AT.date() - timedelta(days=1)
    for certificate, withdrawn, name in ((seal, None, "certificate SSW-1"), (None, revoked, str(revoked))):
        with pytest.raises(CalibrationError, match=f"{name} was signed on {AT.date()}, and by the clock .* {early}"):
            check(certificate, withdrawn, digest=DIGEST if certificate else 64 * "d", today=early)
    check(seal, today=AT.date())


def test_without_a_stated_validity_nothing_lapses(tmp_path, key):
    path = written(tmp_path, "s.json", sign(replace(SEAL, valid_until=None), signing_key(key), AT))
    check(path, today=date(2999, 1, 1))


def test_a_certificate_of_another_calibration_is_refused(seal):
    with pytest.raises(CalibrationError, match="is of another calibration"):
        check(seal, digest=64 * "d")


def test_what_a_list_withdraws_is_refused_by_certificate_or_calibration(seal, revoked, key):
    for certificate in (seal, None):
        with pytest.raises(CalibrationError, match="SSW-1 of this calibration was revoked on 2027-01-02 by Ada"):
            check(certificate, revoked, public_key=f"{key}.pub")
    check(None, revoked, digest=64 * "d")


def test_a_calibration_that_another_certificate_covers_is_not_refused(seal, tmp_path, key):
    entry = Withdrawn("SSW-0", "", "replaced by certificate SSW-1 on 2027-01-02 by Ada: name")
    listed = written(tmp_path, "list.json", sign(WithdrawnList((entry,)), signing_key(key), AT))
    check(seal, listed)
    check(None, listed)


def test_a_changed_list_is_refused(revoked):
    revoked.write_text(revoked.read_text().replace("SSW-1", "SSW-2"))
    with pytest.raises(CalibrationError, match="does not fit"):
        check(None, revoked)


@pytest.mark.parametrize(
    "text",
    ["", "{", "[]", "{}", '{"format": "cbsr-qa certificate"}', '{"format": "cbsr-qa withdrawn certificates"}'],
)
def test_other_files_are_refused_by_name(tmp_path, text):
    path = tmp_path / "odd.json"
    path.write_text(text)
    for read in (read_seal, read_withdrawn):
        with pytest.raises(CalibrationError, match=r"odd\.json cannot be read"):
            read(path)
    with pytest.raises(CalibrationError, match=r"none\.json cannot be read: No such file"):
        read_seal(tmp_path / "none.json")


def test_page_and_xml_in_the_place_of_the_signature_file_are_named(tmp_path):
    for name, text in (("SSW-1.html", "<!DOCTYPE html>"), ("SSW-1.xml", "<?xml version='1.0'?>")):
        (tmp_path / name).write_text(text)
        with pytest.raises(CalibrationError, match="it is not the signature file of a certificate") as refused:
            read_seal(tmp_path / name)
        assert "NUMBER.signature.json" in refused.value.remedy
        with pytest.raises(CalibrationError, match="it is not a list of withdrawn certificates"):
            read_withdrawn(tmp_path / name)


@pytest.mark.parametrize(("day", "odd"), [("2027-11-21", "2027-13-21"), (AT.date().isoformat(), "2026-13-13")])
def test_a_day_that_is_no_date_is_refused(seal, day, odd):
    assert day in seal.read_text()
    seal.write_text(seal.read_text().replace(day, odd))
    with pytest.raises(CalibrationError, match="cannot be read"):
        read_seal(seal)


def test_the_runtime_refuses_what_has_lapsed_or_was_withdrawn(tmp_path, key):
    issued = force_calibration()
    path = tmp_path / "sensor.h5"
    write_calibration(path, issued)
    own = replace(SEAL, calibration_digest=issued.digest)
    seal = written(tmp_path, "own.json", sign(own, signing_key(key), AT))
    public = f"{key}.pub"
    loaded = qa.load_calibration(path, public_key=public, certificate=seal, today=IN_TIME)
    assert loaded.issued.digest == issued.digest
    with pytest.raises(CalibrationError, match="lapsed"):
        qa.load_calibration(path, public_key=public, certificate=seal, today=LATE)
    entry = Withdrawn("SSW-1", issued.digest, "revoked on 2027-01-02 by Ada: wrong head")
    listed = written(tmp_path, "list.json", sign(WithdrawnList((entry,)), signing_key(key), AT))
    with pytest.raises(CalibrationError, match="was revoked"):
        qa.load_calibration(path, certificate=seal, withdrawn=listed, today=IN_TIME)
    with pytest.raises(CalibrationError, match="was revoked"):
        qa.load_calibration(path, withdrawn=listed)
    assert qa.load_calibration(path).issued.digest == issued.digest  # nobody asked


def test_a_certificate_of_another_file_is_refused_by_the_runtime(tmp_path, seal):
    path = tmp_path / "sensor.h5"
    write_calibration(path, force_calibration())
    with pytest.raises(CalibrationError, match="is of another calibration"):
        qa.load_calibration(path, certificate=seal, today=IN_TIME)
    assert stamp(sparse_calibration()).digest != DIGEST


def test_a_key_that_others_may_read_is_warned_of(key):
    assert signing_key(key).warnings == ()
    key.chmod(0o640)
    (warning,) = signing_key(key).warnings
    assert warning == f"others than its owner may read or change key {key}: chmod 600"
