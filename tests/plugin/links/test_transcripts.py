"""Transcripts of links: written and read without loss, replayed byte for byte, and refused if they are not whole."""

import base64
import errno
import gzip
import random
from dataclasses import replace

import pytest
from pyvisa.errors import VisaIOError

from cbsr_qa.domain.errors import ConfigError, InstrumentError, RefusedError
from cbsr_qa.domain.plan.plan import InstrumentSpec
from cbsr_qa.plugin.links.recorder import Recorder
from cbsr_qa.plugin.links.replay import Replay, ReplayedLink
from cbsr_qa.plugin.links.serial_link import SerialLink
from cbsr_qa.plugin.links.taps import is_replaying, use_tap
from cbsr_qa.plugin.links.transcript import Event, Transcript, digest, end_line, escape, unescape
from cbsr_qa.station.setup import configure
from cbsr_qa.system.clock import VirtualClock
from cbsr_qa.testing import replay_pairs, replay_transcript


@pytest.fixture(scope="module")
def station():
    shipped = configure("simulated", "golden-check", sensor_type=None, material=None, seed=3).station
    cell = InstrumentSpec("load_cell", "serial-load-cell", ("force",), {"token": "hunter2"}, None)
    return replace(shipped, instruments=(cell,))


def with_options(station, **options):
    return replace(station, instruments=(replace(station.instruments[0], options=options),))


class Wire:
    """A serial port that answers every line with its reverse, an octet at a time where it is slow."""

    def __init__(self):
        self.sent, self.waiting = bytearray(), bytearray(b"\x00stale")
        self.timeout, self.is_open, self.port = None, True, "wire"

    @property
    def in_waiting(self):
        return len(self.waiting)

    def write(self, data):
        self.sent += data
        self.waiting += data[::-1]
        return len(data)

    def read(self, size):
        taken = bytes(self.waiting[: min(size, 3)])
        del self.waiting[: len(taken)]
        return taken

    def reset_input_buffer(self):
        self.waiting.clear()

    def close(self):
        self.is_open = False


def talk(link, clock):
    """Say some lines and return what came, and when."""
    link.reset_input_buffer()
    heard = []
    for words in (b"\x01 one \\ two \xff\n", b"say hunter2", b"\r\t "):
        link.write(words)
        clock.sleep(0.25)
        link.timeout = 1.0
        answer = bytearray()
        while len(answer) < len(words):
            answer += link.read(len(words) - len(answer))
        heard.append((bytes(answer), clock.now()))
    return heard


@pytest.fixture
def recorded(station, tmp_path):
    clock, path = VirtualClock(), tmp_path / "t.txt"
    recorder = Recorder(path, station, clock)
    heard = talk(recorder.connect("load_cell", Wire), clock)
    recorder.close()
    return path, heard


def test_any_bytes_are_written_as_printable_text_and_read_back():
    data = bytes(range(256)) + b" \\n \\x20 \\\\ "
    text = escape(data)
    assert text.isprintable()
    assert text.isascii()
    assert not text.endswith(" ")
    assert unescape(text) == data
    source = random.Random(5)
    for _ in range(200):
        some = source.randbytes(source.randrange(40))
        assert unescape(escape(some)) == some


def test_what_was_said_is_answered_again_at_the_same_times_and_secrets_are_not_written(recorded, station):
    path, heard = recorded
    text = path.read_text()
    assert "hunter2" not in text
    assert "say ***" in text
    assert " load_cell - " in text  # what was thrown away is there too
    clock = VirtualClock()
    again = talk(Replay(Transcript.read(path), station, clock).connect("load_cell", Wire), clock)
    hidden = [(answer, at) for answer, at in heard if b"2retnuh" not in answer]
    assert [one for one in again if one in hidden] == hidden
    assert [at for _, at in again] == [at for _, at in heard]


def test_another_word_than_was_sent_is_named_with_its_line(recorded, station):
    link = Replay(Transcript.read(recorded[0]), station, VirtualClock()).connect("load_cell", Wire)
    for _ in range(2):  # also later: its answers belong to other questions
        with pytest.raises(InstrumentError, match=r"t\.txt: line \d+ has sent '.*one.*', now 'M115\\n' is sent"):
            link.write(b"M115\n")
    with pytest.raises(InstrumentError, match="M115"):
        link.read(1)


def test_a_serial_link_meets_a_replay_that_has_ended_as_a_link_that_is_down(recorded, station):
    transcript = Transcript.read(recorded[0])
    with use_tap(Replay(replace(transcript, events=()), station, VirtualClock())):
        assert is_replaying()
        link = SerialLink("load_cell", "emulated", baud=9600, timeout_s=0.05)
        with pytest.raises(InstrumentError, match="ends before"):
            link.write(b"M115\n")
    assert not is_replaying()


def test_an_answer_that_did_not_come_does_not_come_now():
    transcript = Transcript.from_pairs("meter", [(b"*IDN?\n", None), (b"again\n", b"yes\n")])
    link = ReplayedLink(transcript, "meter", VirtualClock())
    link.write_raw(b"*IDN?\n")
    with pytest.raises(VisaIOError, match=r"[Tt]imeout"):
        link.read_raw()
    link.write_raw(b"again\n")
    assert link.read_bytes(4) == b"yes\n"


def test_what_comes_by_itself_is_not_read_before_its_time_and_an_answer_is_waited_for():
    events = [Event(0.0, "board", ">", b"go"), *(Event(number, "board", "<", b"x") for number in (3.0, 3.015, 9.0))]
    clock = VirtualClock()
    link = ReplayedLink(Transcript("s", {}, tuple(events)), "board", clock)
    link.write(b"go")
    link.timeout = 0.02
    assert link.read(3) == b"xx"
    assert clock.now() == pytest.approx(3.015)
    assert link.read(1) == b""
    assert clock.now() == pytest.approx(3.015)
    clock.sleep(5.9)
    link.timeout = 0.2
    assert link.read(1) == b"x"
    assert clock.now() == pytest.approx(9.0, abs=1e-5)


def test_a_failure_of_the_link_fails_again():
    events = (Event(0.0, "cell", ">", b"x"), Event(1.0, "cell", "!", b"SerialException: unplugged"))
    link = ReplayedLink(Transcript("s", {}, events), "cell", VirtualClock())
    link.write(b"x")
    link.timeout = 1.0
    with pytest.raises(OSError, match="unplugged"):
        link.read(1)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda lines: lines[:-3], r"was cut off: line \d+ is not its end; .*|was cut off"),
        (lambda lines: [line.replace(" > ", " < ") for line in lines], "states another SHA-256"),
        (lambda lines: [*lines, "0.0 load_cell > x"], r"continues after line \d+, its end"),
        (lambda lines: ["cbsr-qa transcript 2", *lines[1:]], "is of format 2; this version reads 1"),
        (lambda lines: ["\ufeff" + lines[0], *lines[1:]], "begins with a byte order mark"),
        (lambda lines: [*lines[:3], lines[2], *lines[3:]], "line 4 names instrument 'load_cell' a second time"),
        (lambda lines: [*lines[:4], lines[5], lines[4], *lines[6:]], "was changed"),
        (lambda lines: [*lines[:4], *lines[5:]], r"states \d+ events, and there are \d+"),
        (lambda lines: [*lines[:4], "1.0 load_cell ? x", *lines[5:]], r"line 5 is '1.0 load_cell \? x'"),
        (lambda lines: [*lines[:4], "1.0 load_cell > \\q", *lines[5:]], "is no escape"),
        (lambda lines: lines[1:], "does not begin with"),
        (lambda lines: [], "does not begin with"),
    ],
)
def test_a_file_that_is_not_whole_is_refused_and_says_where(recorded, tmp_path, change, words):
    lines = recorded[0].read_text().splitlines()
    path = tmp_path / "changed.txt"
    path.write_text("".join(f"{line}\n" for line in change(lines)), encoding="utf-8")
    with pytest.raises(RefusedError, match=words):
        Transcript.read(path)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("0.0 load_cell < x", r"line \d+ is at 0 s, before the line above it"),
        ("9.0 meter < x", r"line \d+ is of 'meter', which is not among the instruments"),
    ],
)
def test_events_out_of_order_or_of_no_instrument_are_refused_though_the_digest_fits(recorded, tmp_path, line, words):
    *lines, end = recorded[0].read_text().splitlines()
    lines.append(line)
    path = tmp_path / "forged.txt"
    path.write_text("".join(f"{one}\n" for one in [*lines, end_line(int(end.split()[1]) + 1, digest(lines))]))
    with pytest.raises(RefusedError, match=words):
        Transcript.read(path)


def test_line_ends_of_another_system_and_empty_lines_at_the_end_change_nothing(recorded, tmp_path):
    path = tmp_path / "crlf.txt"
    for content in (recorded[0].read_bytes().replace(b"\n", b"\r\n"), recorded[0].read_bytes() + b"\n\n"):
        path.write_bytes(content)
        assert Transcript.read(str(path)).events == Transcript.read(recorded[0]).events


def test_a_file_that_was_cut_off_is_read_up_to_there_only_if_that_is_asked_for(recorded, tmp_path):
    whole = Transcript.read(recorded[0])
    lines = recorded[0].read_text().splitlines(keepends=True)
    path = tmp_path / "cut.txt"
    for content in ("".join(lines[:6]), "".join(lines[:6]) + lines[6][:-3]):  # also within a line
        path.write_text(content)
        with pytest.raises(RefusedError, match="was cut off"):
            Transcript.read(path)
        cut = Transcript.read(path, whole=False)
        assert cut.events == whole.events[: len(cut.events)]
        assert cut.events[-1].line == 6
        assert cut.early == "the file was cut off after line 6; whether it was changed cannot be seen"
        assert cut.early_s == cut.events[-1].time_s
    path.write_text("".join([*lines, "0.0 load_cell > x\n"]))
    with pytest.raises(RefusedError, match="continues after"):
        Transcript.read(path, whole=False)


def test_a_recording_that_is_stopped_ends_there_and_a_changed_byte_of_it_is_found(station, tmp_path):
    path = tmp_path / "t.txt"
    recorder = Recorder(path, station, VirtualClock(), {"ring": "none", "material": "8 wt% ä"})
    link = recorder.connect("load_cell", Wire)
    link.write(b"one")
    recorder.end_early(KeyboardInterrupt("signal SIGINT"))
    recorder.end_early(ValueError("what came of it"))
    link.write(b"safe")
    recorder.close()
    read = Transcript.read(path)
    assert [event.data for event in read.events] == [b"one"]
    assert read.options == {"ring": "none", "material": "8 wt% ä"}
    assert read.early == "the recording was stopped by signal SIGINT (line 7)"
    link = Replay(read, None, VirtualClock()).connect("load_cell", Wire)
    link.write(b"one")
    for _ in range(2):
        with pytest.raises(InstrumentError, match=r"stopped by signal SIGINT \(line 7\)"):
            link.write(b"two")
    path.write_text(path.read_text().replace("SIGINT", "SIGHUP"))
    with pytest.raises(RefusedError, match="another SHA-256"):
        Transcript.read(path)


def test_the_first_to_go_on_beyond_the_end_breaks_in_and_others_fail(recorded, station):
    def break_in(why):
        raise KeyboardInterrupt(why)

    transcript = replace(Transcript.read(recorded[0]), events=(), early="cut off", early_s=1.0)
    clock = VirtualClock()
    link = Replay(transcript, station, clock, break_in=break_in).connect("load_cell", Wire)
    assert link.in_waiting == 0  # up to there it is known that nothing came
    clock.sleep(1.5)
    with pytest.raises(KeyboardInterrupt, match="cut off"):
        _ = link.in_waiting
    with pytest.raises(InstrumentError, match="cut off"):
        link.write(b"safe")


def test_an_address_that_no_link_can_have_leaves_no_file(station, tmp_path):
    recorder = Recorder(tmp_path / "t.txt", station, VirtualClock())

    def refuse():
        raise ConfigError("address 'usb:1A86' is not a USB device")

    with pytest.raises(ConfigError):
        recorder.connect("load_cell", refuse)
    recorder.close()
    assert not (tmp_path / "t.txt").exists()


def test_a_link_that_failed_to_open_fails_to_open_again_and_goes_on_when_it_is_opened_once_more(station, tmp_path):
    clock, path = VirtualClock(), tmp_path / "t.txt"
    recorder = Recorder(path, station, clock)

    def fail():
        raise InstrumentError("load_cell", "/dev/ttyUSB7", "there is no port /dev/ttyUSB7")

    with pytest.raises(InstrumentError):
        recorder.connect("load_cell", fail)
    for word in (b"one", b"two"):  # opened, closed, and opened again
        recorder.connect("load_cell", Wire).write(word)
    recorder.close()
    replay = Replay(Transcript.read(path), station, VirtualClock())
    with pytest.raises(InstrumentError, match=r"load_cell at .*t\.txt: there is no port /dev/ttyUSB7"):
        replay.connect("load_cell", Wire)
    for word in (b"one", b"two"):
        link = replay.connect("load_cell", Wire)
        link.write(word)
        link.close()


@pytest.mark.parametrize("sign", ["<", ">"])
def test_a_secret_that_passes_octet_by_octet_is_not_written_and_nothing_else_is_lost(station, tmp_path, sign):
    recorder = Recorder(tmp_path / "t.txt", station, VirtualClock())
    recorder.connect("load_cell", Wire)
    said = b"hush, hunter2 hunts; hunte"
    for at in range(len(said)):
        recorder.note("load_cell", sign, said[at : at + 1])
        if at == 3:
            recorder.note("load_cell", "-", b"hunt")  # of the other direction: no part of the same word
    assert "hunter2" not in recorder.describe_last("load_cell")
    recorder.close()
    events = Transcript.read(tmp_path / "t.txt").events
    assert b"".join(event.data for event in events if event.sign == sign) == b"hush, *** hunts; hunte"
    assert b"".join(event.data for event in events if event.sign == "-") == b"hunt"


@pytest.mark.parametrize(
    "options",
    [
        *({name: "hunter2"} for name in ("passwd", "pwd", "PIN", "pass", "api_key", "apikey", "credential")),
        {"auth": {"user": "lab", "password": "hunter2"}},
        {"credentials": {"code": "hunter2"}},
        {"passwords": ["another", "hunter2"]},
        {"logins": [{"secret": "hunter2"}]},
    ],
)
def test_secrets_are_not_written_however_they_are_named_nested_or_encoded(station, tmp_path, options):
    recorder = Recorder(tmp_path / "t.txt", with_options(station, **options), VirtualClock())
    recorder.connect("load_cell", Wire)
    said = [b"hunter2", *(base64.b64encode(before + b"hunter2") for before in (b"", b"a:", b"ab:", b"lab:"))]
    for words in said:
        recorder.note("load_cell", ">", b"Authorization " + words + b"\n")
    recorder.close()
    written = b"".join(event.data for event in Transcript.read(tmp_path / "t.txt").events)
    assert b"Authorization ***\n" in written
    assert written.count(b"***") == len(said)
    for words in said:
        assert words.rstrip(b"=") not in written
        assert words.rstrip(b"=")[6:12] not in written


@pytest.mark.parametrize("secret", ["0000", 4821, "200000", "pw"])
def test_a_secret_that_numbers_hold_too_is_refused_by_its_option_and_not_repeated(station, tmp_path, secret):
    with pytest.raises(RefusedError, match=r"instruments\.load_cell\.auth\.pin is too short") as refused:
        Recorder(tmp_path / "t.txt", with_options(station, auth={"pin": secret}), VirtualClock())
    assert str(secret) not in str(refused.value)
    assert not (tmp_path / "t.txt").exists()


def test_a_wire_or_a_switch_is_no_secret(station, tmp_path):
    options = {"reset_pin": 16, "pins": [1, 2], "password_needed": True, "token": ""}
    recorder = Recorder(tmp_path / "t.txt", with_options(station, **options), VirtualClock())
    recorder.connect("load_cell", Wire)
    recorder.note("load_cell", ">", b"16 12 True\n")
    recorder.close()
    assert Transcript.read(tmp_path / "t.txt").events[0].data == b"16 12 True\n"


def test_what_ends_as_a_secret_begins_is_replayed_as_it_was_sent(station, tmp_path):
    said = [b"path", b"h", b"x\n", b"hunt", b"hush, hunter2", b"path"]
    recorder = Recorder(tmp_path / "t.txt", station, VirtualClock())
    link = recorder.connect("load_cell", Wire)
    for words in said:
        link.write(words)
    recorder.close()
    transcript = Transcript.read(tmp_path / "t.txt")
    assert [event.data for event in transcript.events] == [*said[:4], b"hush, ***", b"path"]
    again = Replay(transcript, station, VirtualClock()).connect("load_cell", Wire)
    for words in said:
        again.write(words)


def test_what_came_from_an_instrument_that_was_asked_nothing_is_said(station, tmp_path):
    recorder = Recorder(tmp_path / "t.txt", station, VirtualClock())
    assert recorder.describe_last("load_cell") == ""
    recorder.note("load_cell", "<", b"\xf8\x80x")
    recorder.close()
    assert recorder.describe_last("load_cell") == r"received '\xf8\x80x', unasked"


def test_a_full_disk_is_no_failure_of_an_instrument_and_the_file_is_known_not_to_be_whole(station, tmp_path):
    class Full:
        def write(self, text):
            raise OSError(errno.ENOSPC, "No space left on device")

        def close(self):
            raise OSError(errno.ENOSPC, "No space left on device")

    recorder = Recorder(tmp_path / "t.txt", station, VirtualClock())
    link = recorder.connect("load_cell", Wire)
    link.write(b"one")
    recorder._file.close()
    recorder._file = Full()
    assert link.write(b"two") == 3
    recorder.close()
    assert recorder.failure == "No space left on device"
    with pytest.raises(RefusedError, match="was cut off"):
        Transcript.read(tmp_path / "t.txt")


def test_what_was_said_before_a_crash_is_in_the_file(station, tmp_path):
    recorder = Recorder(tmp_path / "t.txt", station, VirtualClock())
    recorder.connect("load_cell", Wire).write(b"one")
    said = (tmp_path / "t.txt").read_text()
    recorder.close()
    assert said.endswith(" load_cell > one\n")


def test_what_fails_because_the_driver_closed_the_link_is_no_failure_of_it(station, tmp_path):
    class Failing(Wire):
        def read(self, size):
            raise TypeError("'NoneType' object cannot be interpreted as an integer")

    recorder = Recorder(tmp_path / "t.txt", station, VirtualClock())
    link = recorder.connect("load_cell", Failing)
    with pytest.raises(TypeError):
        link.read(1)
    link.close()
    with pytest.raises(TypeError):
        link.read(1)
    recorder.close()
    assert [event.sign for event in Transcript.read(tmp_path / "t.txt").events] == ["!"]


@pytest.mark.parametrize("opened", [False, True])
def test_a_recording_of_no_link_leaves_no_file_and_one_of_a_silent_link_does(station, tmp_path, opened):
    recorder = Recorder(tmp_path / "t.txt", station, VirtualClock())
    if opened:
        recorder.connect("load_cell", Wire)
    recorder.close()
    assert (tmp_path / "t.txt").exists() == opened
    if opened:
        assert Transcript.read(tmp_path / "t.txt").events == ()


def test_pairs_of_a_drivers_test_are_replayed_to_a_link_with_their_line_ends():
    def drive():
        with replay_pairs("meter", [(None, "ready"), ("VOLT?", b"1.5"), (b"OUTP 0", None)], VirtualClock()):
            link = SerialLink("meter", "any", baud=9600, timeout_s=0.05)
            assert link.read_line() == b"ready"
            link.write(b"VOLT?\n")
            assert link.read_line() == b"1.5"
            with pytest.raises(InstrumentError, match=words) as raised:
                link.write(b"OUTP 1\n")
            assert not raised.value.remedy  # about a station file, which such a test does not have

    words = r"pair 3 has sent 'OUTP 0\\n', now 'OUTP 1\\n'"
    with pytest.raises(AssertionError, match=words):  # also where a driver catches the error
        drive()


def test_a_driver_that_leaves_something_out_fails_its_test(recorded):
    clock = VirtualClock()
    pairs = [("T?", "1"), ("OUTP 0", None)]
    left_out = r"pair 2 has sent 'OUTP 0\\n', which is not sent now"
    with pytest.raises(AssertionError, match=left_out), replay_pairs("meter", pairs, clock):
        SerialLink("meter", "any", baud=9600, timeout_s=0.05).write(b"T?\n")
    with pytest.raises(AssertionError, match=r"pair 1 has sent"), replay_pairs("meter", [("T?", "1")], clock):
        pass  # not even opened
    with replay_pairs("meter", [("T?", "1")], clock):
        SerialLink("meter", "any", baud=9600, timeout_s=0.05).write(b"T?\n")  # what came need not be read
    with (
        pytest.raises(AssertionError, match=r"line \d+ has sent '.*one.*', which"),
        replay_transcript(recorded[0], clock),
    ):
        SerialLink("load_cell", "any", baud=9600, timeout_s=0.05)
    with pytest.raises(ZeroDivisionError), replay_pairs("meter", [("T?", "1")], clock):
        raise ZeroDivisionError  # a test's own failure comes first


@pytest.mark.parametrize(
    ("message", "data"),
    [
        ("21.5 °C", "21.5 °C".encode()),
        ([0x31, 0x32], b"12"),
        ((0x31,), b"1"),
        (5, b"5"),
        (2.5, b"2.5"),
        (bytearray(b"x"), b"x"),
    ],
)
def test_pairs_may_be_all_that_pymeasure_takes(message, data):
    (event,) = Transcript.from_pairs("meter", [(None, message)], end=b"\n").events
    assert event.data == data + b"\n"


@pytest.mark.parametrize("pair", [("T?", "1", "2"), ("T?",), ("T?", [300]), ("T?", object()), ("T?", True), 7])
def test_a_pair_that_is_none_is_named(pair):
    with pytest.raises(RefusedError, match=r"pair 2 is ") as refused:
        Transcript.from_pairs("meter", [("T?", "1"), pair])
    assert "(sent, received)" in refused.value.remedy


def test_a_file_of_other_bytes_or_none_is_refused(tmp_path):
    for content, words in (
        (b"\xe4", "byte 1 is not ASCII"),
        ("cbsr-qa transcript 1".encode("utf-16"), "is UTF-16 text"),
        ("cbsr-qa transcript 1".encode("utf-16-be"), "is UTF-16 text"),
        (gzip.compress(b"cbsr-qa transcript 1"), r"is compressed \(gzip\)"),
    ):
        (tmp_path / "binary").write_bytes(content)
        with pytest.raises(RefusedError, match=words):
            Transcript.read(tmp_path / "binary")
    with pytest.raises(RefusedError, match="cannot be read"):
        Transcript.read(tmp_path / "none")


def test_a_transcript_of_another_driver_or_without_the_instrument_is_refused(recorded, station):
    transcript = Transcript.read(recorded[0])
    for drivers, words in (
        ({"load_cell": "phidget-bridge"}, "with driver phidget-bridge, at station 'simulated'"),
        ({}, "without this instrument"),
    ):
        with pytest.raises(RefusedError, match=words):
            Replay(replace(transcript, drivers=drivers), station, VirtualClock())


def test_a_file_is_never_written_over(recorded, station):
    with pytest.raises(RefusedError, match="exists already"):
        Recorder(recorded[0], station, VirtualClock())
