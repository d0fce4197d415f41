"""The VISA link over a real socket: whole answers to the right question, or an InstrumentError."""

import socket
import threading
from types import SimpleNamespace

import numpy as np
import pytest

from cbsr_qa.domain.errors import ConfigError, InstrumentError
from cbsr_qa.plugin.links import visa_link
from cbsr_qa.plugin.links.serial_link import SerialLink
from cbsr_qa.plugin.links.visa_link import VisaLink
from cbsr_qa.simulate.instruments import streams
from cbsr_qa.simulate.instruments.streams import Fault, PtyPort, TcpPort
from cbsr_qa.system.clock import RealClock

#: Their bytes hold line ends.
NUMBERS = np.frombuffer(b"\n\n\n\n" + b"\x00\x0a\x80\x3f" * 3, "<f4")


class Talker:
    """Answers what a test needs; keeps what it heard."""

    def __init__(self):
        self.heard = []
        self.says = {}

    def receive(self, data):
        said = b""
        for line in data.decode().splitlines():
            self.heard.append(line)
            if line.startswith('print("'):
                said += line[7:-2].encode() + b"\n"
            said += self.says.get(line, b"")
        return said

    def misbehave(self, fault):
        raise AssertionError(fault)


@pytest.fixture
def port():
    one = TcpPort("talker")
    one.talker = Talker()
    one.serve(one.talker)
    yield one
    one.close()
    assert one.failure is None


@pytest.fixture
def link(port):
    one = VisaLink("meter", port.address, timeout_s=0.2)
    yield one
    one.close()


def test_a_line_is_answered_by_a_line(link, port):
    port.talker.says["*IDN?"] = b"somebody\r\n"
    assert link.query("*IDN?") == "somebody"


def test_marked_answers_are_given_without_their_mark(link, port):
    port.talker.says["ask"] = b"w7\t1.5\t2\n"
    assert link.query("ask", mark="w7") == "1.5\t2"


def test_an_answer_to_another_question_is_refused_and_may_be_asked_again(link, port):
    port.talker.says["ask"] = b"w6\t1.5\n"
    with pytest.raises(InstrumentError, match="marked 'w7'") as refused:
        link.query("ask", mark="w7")
    assert refused.value.retryable


def test_numbers_are_read_by_their_length_whatever_bytes_they_have(link, port):
    port.talker.says["numbers"] = b"#0" + NUMBERS.tobytes() + b"\n" + b"000007\n"
    assert link.query_binary("numbers", 4, mark="000007").tolist() == NUMBERS.tolist()
    assert link.query('print("next")') == "next"


@pytest.mark.parametrize(
    "said",
    [b"?0" + NUMBERS.tobytes() + b"\n7\n", b"#0" + NUMBERS.tobytes() + b"x7\n", b"#0" + NUMBERS.tobytes() + b"\n6\n"],
)
def test_numbers_that_are_garbled_or_of_another_question_are_refused(link, port, said):
    port.talker.says["numbers"] = said
    with pytest.raises(InstrumentError, match=f"^meter at {port.address}") as refused:
        link.query_binary("numbers", 4, mark="7")
    assert refused.value.retryable


def test_numbers_that_end_early_are_no_numbers(link, port):
    port.talker.says["numbers"] = b"#0" + NUMBERS.tobytes()[:-1]
    with pytest.raises(InstrumentError, match=r"no answer within 0\.2 s") as late:
        link.query_binary("numbers", 4)
    assert late.value.retryable


def test_after_a_late_answer_the_next_is_the_right_one(link, port, monkeypatch):
    monkeypatch.setattr(streams, "LATE_S", 0.85)
    port.faults.arm(Fault.DELAY)
    with pytest.raises(InstrumentError, match="no answer within"):
        link.query('print("late")')
    link.recover()
    assert link.query('print("on time")') == "on time"


def test_an_instrument_that_fell_silent_does_not_recover(link, port):
    port.faults.arm(Fault.SILENCE)
    with pytest.raises(InstrumentError):
        link.query('print("a")')
    with pytest.raises(InstrumentError, match=r"no answer within 0\.8 s") as silent:
        link.recover()
    assert not silent.value.retryable
    assert "switched on" in silent.value.remedy


def test_a_link_that_hung_up_is_opened_again_where_somebody_listens(link, port):
    link.query('print("somebody is there")')
    port._talking.shutdown(socket.SHUT_RDWR)  # the instrument hangs up, and goes on listening
    with pytest.raises(InstrumentError):
        link.query('print("a")')
    link.recover()
    assert link.query('print("b")') == "b"


def test_a_link_that_stays_down_says_that_nothing_listens(link, port):
    port.faults.arm(Fault.DROP)
    for _ in range(2):
        with pytest.raises(InstrumentError):
            link.query('print("a")')
    with pytest.raises(InstrumentError, match="nothing listens there") as refused:
        link.recover()
    assert refused.value.retryable


def test_a_port_nobody_listens_on_is_refused_at_the_first_question():
    link = VisaLink("meter", "TCPIP::127.0.0.1::1::SOCKET", timeout_s=0.1)
    with pytest.raises(InstrumentError, match=r"meter at TCPIP::127\.0\.0\.1::1::SOCKET: nothing listens there"):
        link.query("*IDN?")
    link.close()


@pytest.mark.parametrize("address", ["nonsense", "TCPIP::x::SOCKET", ""])
def test_an_address_that_is_none_is_a_mistake_of_the_station_file(address):
    with pytest.raises(ConfigError, match="is not a VISA resource") as refused:
        VisaLink("meter", address)
    assert "5025" in refused.value.remedy


def test_a_port_that_is_not_there_is_named():
    with pytest.raises(InstrumentError, match=r"meter at ASRL/dev/ttyNOT::INSTR: it does not open"):
        VisaLink("meter", "ASRL/dev/ttyNOT::INSTR")


def test_a_backend_that_is_not_installed_is_named(port):
    with pytest.raises(ConfigError, match="no VISA backend '@nothing'"):
        VisaLink("meter", port.address, backend="@nothing")
    VisaLink("meter", port.address).close()  # and the lock was given back


@pytest.mark.parametrize(
    ("address", "library", "remedy"),
    [
        ("USB0::0x05E6::0x2634::4012345::INSTR", "PyUSB", "pip install pyusb"),
        ("gpib0::26::INSTR", "linux-gpib (Linux) or gpib-ctypes", "install linux-gpib"),
    ],
)
def test_a_library_that_is_missing_is_named_and_not_the_power_switch(monkeypatch, address, library, remedy):
    def open_resource(*asked, **options):
        raise ValueError(f"Please install {library} to use this resource type.\nNo module named 'x'")

    monkeypatch.setitem(visa_link._managers, "@py", SimpleNamespace(open_resource=open_resource))
    with pytest.raises(InstrumentError, match="library for this kind of address is not installed") as missing:
        VisaLink("meter", address)
    assert remedy in missing.value.remedy
    assert "switched on" not in missing.value.remedy
    assert not missing.value.retryable


@pytest.mark.parametrize("kind", ["5025::SOCKET", "INSTR"])
def test_a_host_that_nobody_knows_is_named(monkeypatch, kind):
    def lookup(*asked, **options):
        raise socket.gaierror(-2, "Name or service not known")

    def open_resource(*asked, **options):
        raise OSError(9, "Bad file descriptor")  # as pyvisa-py says it

    monkeypatch.setattr(socket, "getaddrinfo", lookup)
    monkeypatch.setitem(visa_link._managers, "@py", SimpleNamespace(open_resource=open_resource))
    with pytest.raises(InstrumentError, match=r"no computer or instrument 'smu\.invalid' is known") as unknown:
        VisaLink("meter", f"TCPIP::smu.invalid::{kind}", timeout_s=0.2)
    assert "IP address" in unknown.value.remedy
    assert unknown.value.retryable


def test_a_time_is_told_in_figures_that_matter_and_may_be_raised(port):
    link = VisaLink("meter", port.address, timeout_s=0.20012)
    port.faults.arm(Fault.SILENCE)
    with pytest.raises(InstrumentError, match=r"no answer within 0\.2 s") as late:
        link.query("*IDN?")
    link.close()
    assert "raise 'timeout_s'" in late.value.remedy


def test_a_second_link_is_refused(link, port):
    with pytest.raises(InstrumentError, match="'meter' of this program has the same address"):
        VisaLink("second", port.address)
    link.close()
    VisaLink("second", port.address).close()


def test_a_resource_that_is_written_otherwise_is_the_same_one(link, port):
    with pytest.raises(InstrumentError, match="'meter' of this program has the same address"):
        VisaLink("second", port.address.replace("TCPIP::", "TCPIP0::"))


def test_a_serial_port_is_one_resource_whoever_opens_it():
    port = PtyPort("talker")
    talker = Talker()
    talker.says["*IDN?"] = b"somebody\r\n"
    port.serve(talker)
    link = VisaLink("meter", f"ASRL{port.address}::INSTR", timeout_s=0.5)
    try:
        assert link.query("*IDN?") == "somebody"
        for opened_again in (lambda: VisaLink("second", f"ASRL{port.address}"), lambda: serial_link(port.address)):
            with pytest.raises(InstrumentError, match="'meter' of this program has"):
                opened_again()
        port.hang_up()
        with pytest.raises(InstrumentError, match="the link is down") as down:
            link.query("*IDN?")
        assert down.value.retryable
    finally:
        link.close()
        port.close()


def serial_link(address):
    return SerialLink("multiplexer", address, baud=9600)


def test_one_thread_writes_while_another_waits(port):
    link = VisaLink("meter", port.address, timeout_s=0.5)
    failed = []

    def hang():
        try:
            link.query("nothing answers this")
        except InstrumentError as error:
            failed.append(error)

    waiting = threading.Thread(target=hang)
    waiting.start()
    time = RealClock()
    while "nothing answers this" not in port.talker.heard:
        assert time.now() < 5
    link.write("off")
    while "off" not in port.talker.heard:
        assert time.now() < 5
    assert waiting.is_alive()
    waiting.join()
    assert failed
    link.close()


def test_a_closed_link_is_an_instrument_error_too(link):
    link.close()
    link.close()
    with pytest.raises(InstrumentError, match="the link is down"):
        link.query("*IDN?")
