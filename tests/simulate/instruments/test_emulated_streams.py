"""Byte streams of emulated instruments: bytes come through, and every fault of a link is what it says."""

import socket
from concurrent.futures import ThreadPoolExecutor

import pytest
import serial

from cbsr_qa.simulate.instruments.streams import Fault, PtyPort, TcpPort, WatchedClock

PATIENCE_S = 2.0


class Echo:
    """Answers every byte string with itself in brackets."""

    def __init__(self):
        self.faults = []

    def receive(self, data):
        return b"<" + data + b">"

    def misbehave(self, fault):
        self.faults.append(fault)


@pytest.fixture
def line():
    port, echo = PtyPort("echo"), Echo()
    port.serve(echo)
    with serial.Serial(port.address, timeout=PATIENCE_S) as driver:
        yield port, echo, driver
    port.close()


def asked(driver, data, expected_bytes):
    driver.write(data)
    return driver.read(expected_bytes)


def until_it_fails(driver):
    for _ in range(3):
        driver.read(3)


def test_a_pseudo_terminal_carries_any_byte(line):
    _, _, driver = line
    every = bytes(range(256))
    assert asked(driver, every, 258) == b"<" + every + b">"


def test_a_driver_may_open_the_line_again(line):
    port, _, driver = line
    driver.close()
    with serial.Serial(port.address, timeout=PATIENCE_S) as again:
        assert asked(again, b"a", 3) == b"<a>"


def test_what_nobody_asked_for_arrives(line):
    port, _, driver = line
    port.send(b"start\n")
    assert driver.read(6) == b"start\n"


def test_bytes_without_room_are_lost_and_nobody_waits(line):
    port, _, driver = line
    sent = 40 * 4096
    for _ in range(40):
        port.send(b"x" * 4096)
    driver.timeout = 0.2
    assert 0 < len(driver.read(sent)) < sent


def test_a_dropped_link_hangs_up(line):
    port, _, driver = line
    port.faults.arm(Fault.DROP)
    driver.write(b"a")
    with pytest.raises((serial.SerialException, OSError)):
        until_it_fails(driver)


def test_a_silent_instrument_never_answers_again(line):
    port, _, driver = line
    driver.timeout = 0.2
    port.faults.arm(Fault.SILENCE)
    assert asked(driver, b"a", 3) == b""
    assert asked(driver, b"b", 3) == b""


def test_a_garbled_reply_differs_in_one_byte_and_the_next_is_whole(line):
    port, _, driver = line
    port.faults.arm(Fault.GARBLE)
    garbled = asked(driver, b"abc", 5)
    assert sum(a != b for a, b in zip(garbled, b"<abc>", strict=True)) == 1
    assert asked(driver, b"abc", 5) == b"<abc>"


def test_a_stale_reply_comes_ahead_of_the_right_one(line):
    port, _, driver = line
    asked(driver, b"old", 5)
    port.faults.arm(Fault.STALE)
    assert asked(driver, b"new", 10) == b"<old><new>"


def test_a_late_reply_comes_after_the_driver_gave_up(line):
    port, _, driver = line
    port.faults.arm(Fault.DELAY)
    driver.timeout = 0.3
    assert asked(driver, b"a", 3) == b""
    driver.timeout = 10
    assert driver.read(3) == b"<a>"


def test_other_faults_are_the_instruments_own(line):
    port, echo, driver = line
    port.faults.arm(Fault.RESET)
    assert asked(driver, b"a", 3) == b"<a>"
    assert echo.faults == [Fault.RESET]


def test_an_instrument_that_fails_hangs_up_and_says_why(line):
    port, echo, driver = line

    def broken(data):
        raise ValueError(data)

    echo.receive = broken
    driver.write(b"a")
    with pytest.raises((serial.SerialException, OSError)):
        until_it_fails(driver)
    assert isinstance(port.failure, ValueError)


def test_a_socket_takes_one_driver_after_the_other():
    port, echo = TcpPort("echo"), Echo()
    port.serve(echo)
    for _ in range(2):
        with socket.create_connection(("127.0.0.1", port.number), timeout=PATIENCE_S) as driver:
            driver.sendall(b"hello")
            assert driver.recv(100) == b"<hello>"
    port.faults.arm(Fault.DROP)
    with socket.create_connection(("127.0.0.1", port.number), timeout=PATIENCE_S) as driver:
        driver.sendall(b"hello")
        assert driver.recv(100) == b""
    port.close()
    with pytest.raises(OSError, match="refused"):
        socket.create_connection(("127.0.0.1", port.number), timeout=PATIENCE_S)


def test_a_watched_clock_loses_no_time_between_threads():
    clock = WatchedClock()
    seen = []
    clock.watch(seen.append)
    with ThreadPoolExecutor(4) as pool:
        list(pool.map(lambda _: [clock.sleep(0.25) for _ in range(100)], range(4)))
    assert clock.now() == 100.0
    assert seen == [0.25 * (k + 1) for k in range(400)]
