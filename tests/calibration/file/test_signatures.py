"""Signatures of calibrations: kept in every format, and no changed bit, other key or stripped signature passes."""

import hashlib
import json
import random
from dataclasses import replace
from functools import partial
from pathlib import Path

import h5py
import pytest
from calibration_samples import assert_same, edited, forged, plain_digest, sample_calibration
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.serialization import load_pem_public_key
from pressed_sheets import issued_from_presses
from signed_samples import AT, made_key, signed_sample

from cbsr_qa.calibration.file.content import content_digest
from cbsr_qa.calibration.file.entries import encode
from cbsr_qa.calibration.file.hdf5 import (
    calibration_of,
    read_issued,
    sign_calibration,
    stamp,
    verify_calibration_file,
    write_calibration,
)
from cbsr_qa.calibration.file.json import json_document, read_json_calibration, verify_json_calibration
from cbsr_qa.calibration.file.keys import public_key, signing_key
from cbsr_qa.calibration.file.signing import check_signature, check_signed_file
from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.domain.results.signature import fingerprint
from cbsr_qa.system.untrusted import read_untrusted

_READERS = {".h5": read_issued, ".json": read_json_calibration}


@pytest.fixture(scope="module")
def key(tmp_path_factory):
    return made_key(tmp_path_factory.mktemp("keys"))


@pytest.fixture(scope="module")
def pub(key):
    return Path(f"{key}.pub")


@pytest.fixture(scope="module")
def pinned(pub):
    return public_key(pub)


@pytest.fixture(scope="module")
def calibration(key):
    return signed_sample(key)


def _write(path, calibration):
    if path.suffix == ".h5":
        write_calibration(path, calibration)
    else:
        path.write_text(json.dumps(json_document(calibration), ensure_ascii=False, separators=(",", ":")))
    return path


@pytest.fixture(params=_READERS)
def file(request, calibration, tmp_path):
    return _write(tmp_path / f"signed{request.param}", calibration)


def _read(path):
    return _READERS[path.suffix](path)


# --- what is signed ----------------------------------------------------------------------------------------


def test_a_signature_is_kept_from_format_to_format(calibration, tmp_path, pinned):
    before = calibration
    for number, suffix in enumerate((".h5", ".json", ".h5", ".json")):
        before = _read(_write(tmp_path / f"{number}{suffix}", before))
        check_signature(before, pinned)
        assert_same(before, calibration, suffix)
    assert (tmp_path / "2.h5").read_bytes() == calibration.file
    assert calibration.signature.signed_at == "2026-11-27T09:30:15+00:00"
    assert verify_calibration_file(tmp_path / "0.h5").signature == calibration.signature
    assert verify_json_calibration(tmp_path / "1.json").signature == calibration.signature


def test_signing_changes_nothing_but_the_signature(calibration):
    unsigned = replace(calibration, signature=None)
    assert stamp(unsigned).digest == calibration.digest
    assert_same(replace(calibration_of(calibration.file), signature=None), unsigned, "signed")
    assert calibration_of(stamp(unsigned).file).signature is None


def test_a_calibration_from_presses_is_signed_too(key, pinned, tmp_path):
    issued = sign_calibration(issued_from_presses(), signing_key(key), AT)
    for suffix in (".h5", ".json"):
        back = _read(_write(tmp_path / f"presses{suffix}", issued))
        check_signature(back, pinned)
        assert back.signature == issued.signature


def test_the_documented_statement_is_what_is_signed(calibration, pub, tmp_path):
    """With h5py, hashlib and cryptography alone."""
    path = _write(tmp_path / "signed.h5", calibration)
    public = load_pem_public_key(pub.read_bytes())
    with h5py.File(path) as file:
        stated = {name: file.attrs[name] for name in ("signed_at", "public_key", "signature")}
    lines = ["cbsr-qa calibration signature", plain_digest(path), stated["signed_at"], stated["public_key"]]
    statement = "".join(f"{line}\n" for line in lines).encode()
    public.verify(bytes.fromhex(stated["signature"]), statement)
    with pytest.raises(InvalidSignature):
        public.verify(bytes.fromhex(stated["signature"]), statement.replace(b"9:30", b"9:31"))
    raw = public.public_bytes_raw()
    assert stated["public_key"] == raw.hex()
    assert fingerprint(raw.hex()).replace("-", "") == hashlib.sha256(raw).hexdigest()[:32]


# --- what is found -----------------------------------------------------------------------------------------


def _found_or_unchanged(read, calibration, pinned):
    """Whether a change is named; if not, what is read is bit for bit what was signed."""
    try:
        back = read()
        check_signature(back, pinned)
    except CalibrationError:
        return True
    assert_same(replace(back, file=b""), replace(calibration, file=b""), "changed")
    return False


def _flipped(data, place, bit):
    changed = bytearray(data)
    changed[place] ^= 1 << bit
    return bytes(changed)


def _in_hdf5(calibration, pinned, places):
    for place, bit in places:
        data = _flipped(calibration.file, place, bit)
        assert _found_or_unchanged(lambda data=data: calibration_of(data), calibration, pinned), (place, bit)


def _in_json(path, calibration, pinned, places):
    whole, unseen = _write(path, calibration).read_bytes(), 0
    for place, bit in places:
        path.write_bytes(_flipped(whole, place, bit))
        unseen += not _found_or_unchanged(lambda: read_json_calibration(path), calibration, pinned)
    return unseen


def _some(size, count, seed):
    pick = random.Random(seed)
    return [(pick.randrange(size), pick.randrange(8)) for _ in range(count)]


def test_flipped_bits_of_hdf5_are_found(calibration, pinned):
    _in_hdf5(calibration, pinned, _some(len(calibration.file), 3000, 1))
    _in_hdf5(calibration, pinned, _some(600, 600, 2))


@pytest.mark.rest
def test_every_byte_of_hdf5_is_found(calibration, pinned):
    pick = random.Random(8)
    _in_hdf5(calibration, pinned, [(place, pick.randrange(8)) for place in range(len(calibration.file))])


@pytest.mark.parametrize(
    "step", [None, pytest.param(7, marks=pytest.mark.rest)], ids=["some bits", "every seventh byte"]
)
def test_flipped_bits_of_json_are_found_or_change_no_value(calibration, pinned, tmp_path, step):
    size = len(_write(tmp_path / "signed.json", calibration).read_bytes())
    pick = random.Random(5)
    places = [(place, pick.randrange(8)) for place in range(0, size, step)] if step else _some(size, 400, 3)
    assert _in_json(tmp_path / "flipped.json", calibration, pinned, places) < 0.05 * len(places)
    # Format, version, digest and signature stand first.
    assert not _in_json(tmp_path / "flipped.json", calibration, pinned, _some(500, 200, 4))


@pytest.mark.parametrize(("count", "seed"), [(25, 6), pytest.param(75, 7, marks=pytest.mark.rest)])
def test_bits_flipped_by_a_forger_are_found_or_no_part_of_what_is_read(calibration, pinned, tmp_path, count, seed):
    """Behind the digest of the bytes, which a forger leaves out; HDF5 parses what is left, in a child."""
    image, path, unseen = calibration.file[512:], tmp_path / "forged.h5", 0
    for place, bit in _some(len(image), count, seed):
        path.write_bytes(_flipped(image, place, bit))
        unseen += not _found_or_unchanged(
            lambda: read_untrusted(path, partial(read_issued, path), refusal=CalibrationError), calibration, pinned
        )
    assert unseen < count


def _refused(path, pinned_file, match):
    with pytest.raises(CalibrationError, match=match) as error:
        check_signed_file(path, _read(path), pinned_file)
    assert str(path) in error.value.reason
    assert error.value.remedy
    assert error.value.exit_code == 2


def _in_document(path, change):
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document))


def test_a_forged_value_with_its_own_digest_is_found(file, pub):
    if file.suffix == ".h5":
        with forged(file) as held:
            held["identity/serial"][...] = "S-002"
    else:

        def change(document):
            document["datasets"]["identity/serial"]["values"] = ["S-002"]

        _in_document(file, change)
        with pytest.raises(CalibrationError, match=r"its SHA-256 is ([0-9a-f]{64})") as error:
            _read(file)
        digest = error.value.reason[-64:]
        _in_document(file, lambda document: document.__setitem__("digest", digest))
    for pinned in (pub, None):
        _refused(file, pinned, "does not fit: content, time, key or signature was changed since")


@pytest.mark.parametrize("name", ["public_key", "signed_at", "signature"])
@pytest.mark.parametrize(
    ("value", "said"), [(None, "removed in part: {} is missing"), ("?", "damaged: {}"), (1, "damaged")]
)
def test_a_part_of_a_signature_that_is_removed_or_odd_is_named(file, name, value, said):
    def change(held):
        held.pop(name)
        if value is not None:
            held[name] = value

    if file.suffix == ".h5":
        with edited(file) as held:
            change(held.attrs)
    else:
        _in_document(file, lambda document: change(document["signature"]))
    with pytest.raises(CalibrationError, match=said.format(name)):
        _read(file)


def test_a_stripped_signature_is_named_where_a_key_is_pinned(file, pub):
    if file.suffix == ".h5":
        with edited(file) as held:
            for name in ("public_key", "signed_at", "signature"):
                del held.attrs[name]
    else:
        _in_document(file, lambda document: document.pop("signature"))
    _refused(file, pub, "not signed, and a signature by the pinned key .* it was removed, or there never was one")


def test_another_key_is_named(file, pinned, tmp_path):
    other = Path(f"{made_key(tmp_path, 'other.key')}.pub")
    names = fingerprint(pinned), fingerprint(public_key(other))
    _refused(file, other, f"signed by key {names[0]} at .* not by the pinned key {names[1]}")
    check_signed_file(file, _read(file), None)


def test_a_signature_of_another_file_is_found(file, calibration, pub):
    copied = replace(stamp(sample_calibration()), signature=calibration.signature, file=b"")
    _write(file, copied)
    for pinned in (pub, None):
        _refused(file, pinned, "or the signature is that of another file")


def test_a_key_in_json_that_no_calibration_has_is_named(calibration, tmp_path):
    """So that no changed bit makes a signature a key that nobody reads."""
    path = _write(tmp_path / "signed.json", calibration)
    path.write_text(path.read_text().replace('"signature":{', '"signaturd":{', 1))
    with pytest.raises(CalibrationError, match="no calibration has the key 'signaturd'"):
        read_json_calibration(path)


def test_the_digest_that_is_checked_is_that_of_what_is_in_memory(calibration, pinned):
    changed = replace(calibration, noise_floor=2 * calibration.noise_floor)
    assert changed.digest != content_digest(encode(changed))
    with pytest.raises(CalibrationError, match="does not fit"):
        check_signature(changed, pinned)
