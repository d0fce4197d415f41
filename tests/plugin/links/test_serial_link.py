"""The serial link over a real pseudo terminal: whole answers, lost ones, pulled cables, devices by identity."""

import threading
from types import SimpleNamespace

import pytest
from terminal import Terminal

from cbsr_qa.domain.errors import ConfigError, InstrumentError
from cbsr_qa.plugin.links import serial_link
from cbsr_qa.plugin.links.serial_link import SerialLink
from cbsr_qa.system.clock import RealClock


@pytest.fixture
def terminal():
    end = Terminal()
    yield end
    end.hang_up()


@pytest.fixture
def link(terminal):
    one = SerialLink("load_cell", terminal.path, baud=115200, timeout_s=0.1)
    yield one
    one.close()


def test_bytes_go_both_ways(terminal, link):
    link.write(b"M105\n")
    assert terminal.heard(5) == b"M105\n"
    terminal.say(b"ok\r\n")
    assert link.read(4) == b"ok\r\n"


def test_lines_come_without_their_ends_and_the_rest_stays(terminal, link):
    terminal.say(b"start\r\necho: x\nok")
    assert [link.read_line(), link.read_line()] == [b"start", b"echo: x"]
    assert link.read_available() == b"ok"


def test_an_answer_that_stays_incomplete_may_be_asked_for_again_and_is_kept(terminal, link):
    terminal.say(b"abc")
    with pytest.raises(InstrumentError, match=r"answered 3 of 5 bytes within 0\.1 s") as caught:
        link.read(5)
    assert caught.value.retryable
    assert (caught.value.role, caught.value.address) == ("load_cell", terminal.path)
    terminal.say(b"de")
    assert link.read(5) == b"abcde"


def test_silence_is_an_error_within_its_time(link):
    clock = RealClock()
    with pytest.raises(InstrumentError, match=r"answered nothing within 0\.05 s") as caught:
        link.read_line(timeout_s=0.05)
    assert caught.value.retryable
    assert 0.05 <= clock.now() < 0.5


def test_a_line_that_never_ends_is_no_line(terminal, link):
    for _ in range(5):
        terminal.say(b"x" * 1000)
    with pytest.raises(InstrumentError, match="without a line end, the last 'xxxxxxxxxxxx'"):
        link.read_line(timeout_s=1.0)


@pytest.mark.parametrize(
    ("came", "said"),
    [
        (b"\xf8\x80x\r", r"4 bytes without a line end, the last '\xf8\x80x\r'"),
        (b"21.5\r21.6\r", r"10 bytes whose lines end in \r, not in \n, the last '21.5\r21.6\r'"),
    ],
)
def test_bytes_without_a_line_end_are_quoted(terminal, link, came, said):
    terminal.say(came)
    with pytest.raises(InstrumentError) as caught:
        link.read_line(timeout_s=0.3)
    assert f"answered {said} within 0.3 s" in caught.value.reason
    assert "baud rate" in caught.value.remedy
    assert link.partial_line == came


def test_what_has_come_is_thrown_away(terminal, link):
    terminal.say(b"stale\n")
    link.read(1)
    terminal.say(b"stale too\n")
    link.flush_input()
    terminal.say(b"fresh\n")
    assert link.read_line() == b"fresh"


def test_nothing_available_does_not_wait(link):
    clock = RealClock()
    assert link.read_available() == b""
    assert clock.now() < 0.05


@pytest.mark.parametrize(
    "use",
    [
        lambda one: one.read(1),
        lambda one: one.read_line(),
        lambda one: one.read_available(),
        lambda one: one.write(b"x"),
    ],
    ids=["read", "read_line", "read_available", "write"],
)
def test_a_pulled_cable_is_said_and_not_retryable(terminal, link, use):
    terminal.hang_up()
    with pytest.raises(InstrumentError, match="link is down") as caught:
        use(link)
    assert not caught.value.retryable


def test_after_closing_it_says_so_and_closing_twice_is_fine(link):
    link.close()
    link.close()
    with pytest.raises(InstrumentError, match="link is closed"):
        link.write(b"x")


def test_closing_while_another_thread_reads_ends_the_reading(link):
    met = []

    def read():
        try:
            link.read(1, timeout_s=20.0)
        except InstrumentError as error:
            met.append(error)

    thread = threading.Thread(target=read)
    thread.start()
    link.close()
    thread.join(timeout=2.0)
    assert not thread.is_alive()
    assert len(met) == 1


def test_one_thread_writes_while_another_waits_for_an_answer(terminal, link):
    answers = []
    thread = threading.Thread(target=lambda: answers.append(link.read(2, timeout_s=5.0)))
    thread.start()
    link.write(b"M410\n")
    assert terminal.heard(5) == b"M410\n"
    terminal.say(b"ok")
    thread.join(timeout=2.0)
    assert answers == [b"ok"]


def test_reopening_forgets_what_was_held(terminal, link):
    terminal.say(b"old")
    link.read(1)
    link.reopen()
    terminal.say(b"new")
    assert link.read(3) == b"new"


def test_a_second_opening_is_refused(terminal, link):
    with pytest.raises(InstrumentError, match="of this program has the same address") as caught:
        SerialLink("load_cell", terminal.path, baud=115200)
    assert caught.value.address == terminal.path


def test_no_such_port(tmp_path):
    with pytest.raises(InstrumentError, match="there is no port") as caught:
        SerialLink("load_cell", str(tmp_path / "ttyUSB7"), baud=9600)
    assert "USB serial ports found" in caught.value.remedy


def test_a_file_is_no_port(tmp_path):
    (tmp_path / "notes").write_text("")
    with pytest.raises(InstrumentError, match="does not open"):
        SerialLink("load_cell", str(tmp_path / "notes"), baud=9600)


# --- devices by identity ---


def plugged(monkeypatch, *devices):
    ports = [SimpleNamespace(device=d, vid=v, pid=p, serial_number=s) for d, v, p, s in devices]
    monkeypatch.setattr(serial_link.list_ports, "comports", lambda: ports)


@pytest.mark.parametrize("address", ["usb:2C99:0002", "usb:2c99:2:CZPX1", "USB:2C99:0002:CZPX1"])
def test_a_device_is_found_by_its_identity(monkeypatch, terminal, address):
    plugged(monkeypatch, ("/dev/other", 0x1A86, 0x7523, None), (terminal.path, 0x2C99, 0x0002, "CZPX1"))
    link = SerialLink("head", address, baud=115200)
    assert (link.port, link.address) == (terminal.path, address)
    link.close()


def test_a_device_that_is_not_there_names_those_that_are(monkeypatch):
    plugged(monkeypatch, ("/dev/ttyUSB0", 0x1A86, 0x7523, None))
    with pytest.raises(InstrumentError, match="no such device") as caught:
        SerialLink("head", "usb:2C99:0002", baud=115200)
    assert "/dev/ttyUSB0 (usb:1A86:7523)" in caught.value.remedy


def test_two_devices_alike_must_be_told_apart(monkeypatch, terminal):
    plugged(monkeypatch, ("/dev/a", 0x2C99, 2, "A"), (terminal.path, 0x2C99, 2, "B"))
    with pytest.raises(InstrumentError, match=r"2 such devices are plugged in \(/dev/a, /dev/pts"):
        SerialLink("head", "usb:2C99:0002", baud=115200)
    SerialLink("head", "usb:2C99:0002:B", baud=115200).close()


@pytest.mark.parametrize("serials", [(None, None), ("0001", "0001"), ("A", None), ("A", "0001", "0001")])
def test_two_devices_that_no_serial_number_tells_apart_are_named_by_their_port(monkeypatch, serials):
    plugged(monkeypatch, *((f"/dev/ttyUSB{at}", 0x1A86, 0x7523, serial) for at, serial in enumerate(serials)))
    with pytest.raises(InstrumentError, match="such devices are plugged in") as caught:
        SerialLink("head", "usb:1A86:7523", baud=9600)
    assert "/dev/serial/by-path/" in caught.value.remedy
    assert "SERIAL" not in caught.value.remedy


@pytest.mark.parametrize("address", ["usb:printer", "usb:2C99", "usb::0002"])
def test_a_wrong_identity_is_a_wrong_configuration(address):
    with pytest.raises(ConfigError, match="not a USB device"):
        SerialLink("head", address, baud=115200)


def test_a_device_plugged_in_elsewhere_is_found_again(monkeypatch, terminal):
    first = Terminal()
    plugged(monkeypatch, (first.path, 0x2C99, 2, "A"))
    link = SerialLink("head", "usb:2C99:0002:A", baud=115200, timeout_s=0.1)
    first.hang_up()
    with pytest.raises(InstrumentError, match="link is down"):
        link.read(1)
    plugged(monkeypatch, (terminal.path, 0x2C99, 2, "A"))
    link.reopen()
    terminal.say(b"start\n")
    assert link.read_line() == b"start"
    link.close()
