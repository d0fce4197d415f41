"""Keys of calibrations, and the commands that sign and check: every message that a user may get."""

import json
import os
import stat
import subprocess
import sys

import pytest
from calibration_samples import sparse_calibration
from cryptography.hazmat.primitives.asymmetric import ec, rsa
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, PublicFormat
from force_calibration import force_calibration, frames
from signed_samples import AT, made_key

import cbsr_qa as qa
from cbsr_qa.calibration.file.hdf5 import sign_calibration, stamp, write_calibration
from cbsr_qa.calibration.file.keys import signing_key
from cbsr_qa.cli.main import run_guarded
from cbsr_qa.domain.errors import CalibrationError, RefusedError

_VARIABLE = "CBSR_QA_KEY_PASSPHRASE"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv(_VARIABLE, raising=False)
    write_calibration(tmp_path / "sensor.h5", stamp(sparse_calibration()))
    made_key(tmp_path)
    return tmp_path


@pytest.fixture
def run(folder, capsys):
    """A command of ``calibration``: its exit code, and what it says."""

    def command(*arguments):
        code = run_guarded(["calibration", *map(str, arguments)])
        said = capsys.readouterr()
        return code, " ".join((said.out + said.err).split())

    return command


def _document(run, *arguments):
    code, said = run(*arguments, "--json")
    assert code == 0, said
    return json.loads(said)


# --- keys --------------------------------------------------------------------------------------------------


def test_a_new_key_is_for_its_owner_alone(run, folder):
    before = os.umask(0)
    try:
        made = _document(run, "keygen", "b.key")
    finally:
        os.umask(before)
    assert stat.S_IMODE((folder / "b.key").stat().st_mode) == 0o600
    assert stat.S_IMODE((folder / "b.key.pub").stat().st_mode) == 0o644
    assert (folder / "b.key").read_text().startswith("-----BEGIN PRIVATE KEY-----")
    assert (folder / "b.key.pub").read_text().startswith("-----BEGIN PUBLIC KEY-----")
    assert len(made["fingerprint"]) == 39
    assert made["encrypted"] is False
    assert made["public_key"] == "b.key.pub"


def test_a_key_is_never_replaced(run, folder):
    held = (folder / "a.key").read_bytes()
    code, said = run("keygen", "a.key")
    assert (code, (folder / "a.key").read_bytes()) == (2, held)
    assert "a.key exists already; a key is never replaced" in said
    (folder / "b.key.pub").write_text("something")
    code, said = run("keygen", "b.key")
    assert code == 2
    assert "b.key.pub exists already" in said
    assert not (folder / "b.key").exists()
    assert "cannot be written" in run("keygen", "absent/c.key")[1]


@pytest.mark.parametrize("given", ["päss", "@secret"])
def test_a_passphrase_comes_from_the_environment_or_a_file(run, folder, monkeypatch, given):
    (folder / "secret").write_text("päss\n", encoding="utf-8")
    monkeypatch.setenv(_VARIABLE, given)
    assert _document(run, "keygen", "b.key")["encrypted"] is True
    assert "ENCRYPTED PRIVATE KEY" in (folder / "b.key").read_text()
    assert run("sign", "sensor.h5", "--key", "b.key")[0] == 0
    assert run("sign", "sensor.h5", "--key", "a.key", "--again")[0] == 0  # it needs none


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (None, "key b.key: it has a passphrase, and none is set"),
        ("wrong", "is not that of this key, or the file is damaged"),
        ("", "has 0 bytes; 1 to 1023 are allowed"),
        ("x" * 1024, "has 1024 bytes"),
        ("@absent", "cannot be read: No such file"),
    ],
)
def test_a_passphrase_that_is_wrong_is_named_and_not_shown(run, folder, monkeypatch, given, said):
    monkeypatch.setenv(_VARIABLE, "right")
    run("keygen", "b.key")
    monkeypatch.delenv(_VARIABLE)
    if given is not None:
        monkeypatch.setenv(_VARIABLE, given)
    before = (folder / "sensor.h5").read_bytes()
    code, words = run("sign", "sensor.h5", "--key", "b.key")
    assert (code, (folder / "sensor.h5").read_bytes()) == (2, before)
    assert said in words
    assert f"set {_VARIABLE} to the passphrase, or to @FILE" in words
    assert "wrong" not in words.replace("b.key", "")


@pytest.mark.parametrize(
    ("make", "found"),
    [
        (lambda: rsa.generate_private_key(65537, 2048), "RSA"),
        (lambda: ec.generate_private_key(ec.SECP256R1()), "EC"),
    ],
    ids=["rsa", "ec"],
)
def test_a_key_of_another_type_is_named(run, folder, make, found):
    key = make()
    (folder / "foreign").write_bytes(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    public = key.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo)
    (folder / "foreign.pub").write_bytes(public)
    for arguments in (
        ("sign", "sensor.h5", "--key", "foreign"),
        ("verify", "sensor.h5", "--public-key", "foreign.pub"),
    ):
        code, said = run(*arguments)
        assert code == 2
        assert f"of the type {found}; calibrations are signed with Ed25519" in said


def test_files_that_are_no_such_key_are_named(run, folder):
    (folder / "cut").write_bytes((folder / "a.key").read_bytes()[:60])
    for key, said in (
        ("absent", "cannot be read: No such file"),
        (".", "cannot be read: it is a folder, not a file"),
        ("sensor.h5", "not a private key in PEM, or damaged"),
        ("cut", "not a private key in PEM, or damaged"),
        ("a.key.pub", "a public key, which cannot sign"),
    ):
        code, words = run("sign", "sensor.h5", "--key", key)
        assert code == 2
        assert said in words
    assert "a private key, where a public one" in run("verify", "sensor.h5", "--public-key", "a.key")[1]
    assert "not a public key in PEM" in run("verify", "sensor.h5", "--public-key", "sensor.h5")[1]


# --- signing and checking ----------------------------------------------------------------------------------


def test_an_unsigned_file_is_signed_in_its_place(run, folder):
    before = _document(run, "verify", "sensor.h5")
    assert before["signature"] is None
    code, said = run("verify", "sensor.h5", "--public-key", "a.key.pub")
    assert code == 2
    assert "sensor.h5: not signed, and a signature by the pinned key" in said
    done = _document(run, "sign", "sensor.h5", "--key", "a.key")
    assert (done["digest"], done["replaced"]) == (before["digest"], None)
    after = _document(run, "verify", "sensor.h5", "--public-key", "a.key.pub")
    assert after["signature"] == {"key": done["key"], "signed_at": done["signed_at"], "checked": True, "pinned": True}
    assert after | {"signature": None} == before


def test_without_a_pinned_key_it_says_whose_and_that_none_was_pinned(run):
    key = _document(run, "sign", "sensor.h5", "--key", "a.key")["key"]
    code, said = run("verify", "sensor.h5")
    assert code == 0
    assert f"valid, by key {key}" in said
    assert "no key was pinned, so anybody may have made it" in said
    assert _document(run, "verify", "sensor.h5")["signature"]["pinned"] is False
    assert f"valid, by the pinned key {key}" in run("verify", "sensor.h5", "--public-key", "a.key.pub")[1]


def test_a_signature_is_replaced_only_if_asked(run, folder):
    made_key(folder, "b.key")
    first = _document(run, "sign", "sensor.h5", "--key", "a.key")["key"]
    code, said = run("sign", "sensor.h5", "--key", "b.key")
    assert code == 2
    assert f"signed already, by key {first}" in said
    assert "--again replaces that signature" in said
    assert _document(run, "sign", "sensor.h5", "--key", "b.key", "--again")["replaced"] == first
    code, said = run("verify", "sensor.h5", "--public-key", "a.key.pub")
    assert code == 2
    assert f"not by the pinned key {first}" in said


def test_json_is_signed_and_checked_as_hdf5_is(run, folder):
    run("export", "sensor.h5", "--output", "sensor.json")
    key = _document(run, "sign", "sensor.json", "--key", "a.key")["key"]
    assert _document(run, "verify", "sensor.json", "--public-key", "a.key.pub")["signature"]["key"] == key
    back = _document(run, "export", "sensor.json", "--output", "again.h5")
    assert back["signed_by"] == key
    assert run("verify", "again.h5", "--public-key", "a.key.pub")[0] == 0
    run("sign", "sensor.h5", "--key", "a.key")
    assert _document(run, "export", "sensor.h5", "--output", "direct.json")["signed_by"] == key


def test_a_link_to_a_file_stays_one(run, folder):
    (folder / "latest.h5").symlink_to("sensor.h5")
    assert run("sign", "latest.h5", "--key", "a.key")[0] == 0
    assert (folder / "latest.h5").is_symlink()
    assert run("verify", "sensor.h5", "--public-key", "a.key.pub")[0] == 0


def test_a_damaged_file_is_not_signed(run, folder):
    path = folder / "sensor.h5"
    path.write_bytes(path.read_bytes()[:-1] + b"\1")
    before = path.read_bytes()
    code, said = run("sign", path, "--key", "a.key")
    assert (code, path.read_bytes()) == (2, before)
    assert "truncated, damaged, or changed after it was issued" in said


# --- in use ------------------------------------------------------------------------------------------------


@pytest.fixture
def sensor(folder):
    """A calibration with a force model, signed with ``a.key``."""
    write_calibration(folder / "force.h5", sign_calibration(force_calibration(), signing_key(folder / "a.key"), AT))
    return folder / "force.h5"


def test_the_runtime_checks_it_if_asked(sensor, folder):
    made_key(folder, "b.key")
    seen = frames([(5.0, 7.0)], [3.0])
    checked = qa.load_calibration("force.h5", public_key="a.key.pub").force(seen)
    assert checked.force_N == qa.load_calibration(sensor).force(seen).force_N
    with pytest.raises(CalibrationError, match=r"force\.h5: signed by key .*, not by the pinned key"):
        qa.load_calibration("force.h5", public_key=folder / "b.key.pub")
    write_calibration(sensor, force_calibration())
    with pytest.raises(CalibrationError, match=r"force\.h5: not signed"):
        qa.load_calibration("force.h5", public_key="a.key.pub")


def test_apply_checks_it_if_asked(run, sensor, folder):
    made_key(folder, "b.key")
    code, said = run("apply", "force.h5", "absent.h5", "--public-key", "b.key.pub")
    assert code == 2
    assert "not by the pinned key" in said
    assert "absent.h5" in run("apply", "force.h5", "absent.h5", "--public-key", "a.key.pub")[1]


def test_without_the_library_a_robot_loads_the_file_and_a_check_says_what_to_install(run, sensor, monkeypatch):
    for name in [name for name in sys.modules if name.split(".")[0] == "cryptography"]:
        monkeypatch.setitem(sys.modules, name, None)
    qa.load_calibration("force.h5")
    for call in (lambda: qa.load_calibration("force.h5", public_key="a.key.pub"), lambda: signing_key(sensor)):
        with pytest.raises(RefusedError, match="need cryptography, which is not installed") as error:
            call()
        assert error.value.remedy == "pip install 'cbsr-qa[sign]'"
    for arguments in (("keygen", "c.key"), ("sign", "sensor.h5", "--key", "a.key")):
        assert "pip install 'cbsr-qa[sign]'" in run(*arguments)[1]
    code, said = run("verify", "force.h5", "--public-key", "a.key.pub")
    assert code == 2
    assert "pip install 'cbsr-qa[sign]'" in said
    verified = _document(run, "verify", "force.h5")["signature"]
    assert (verified["checked"], verified["pinned"]) == (False, False)
    assert (
        "its signature was not checked: signatures of calibrations need cryptography" in run("verify", "force.h5")[1]
    )


def test_the_library_is_loaded_only_if_asked(sensor):
    code = "import sys, cbsr_qa as qa; qa.load_calibration('force.h5'); print('cryptography' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
