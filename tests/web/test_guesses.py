"""How long somebody who guesses has to wait."""

from types import SimpleNamespace

import pytest

from cbsr_qa.config.documents import DocumentKind, open_document
from cbsr_qa.system.pins import hash_pin
from cbsr_qa.web.actions import Actions
from cbsr_qa.web.guesses import FREE_GUESSES, LONGEST_WAIT_S, Guesses, TooManyGuessesError, client_network
from cbsr_qa.web.stations import load_stations
from tests.samples.loops import run_coroutine


class _Clock:
    now_s = 1000.0

    def __call__(self):
        return self.now_s


@pytest.fixture
def clock():
    return _Clock()


@pytest.fixture
def guesses(clock):
    return Guesses(clock)


def _wait_s(guesses, guess, who="Ada"):
    try:
        guesses.admit(who, guess)
    except TooManyGuessesError as wait:
        return wait.wait_s
    return 0


def test_waits_double_up_to_the_longest(guesses, clock):
    assert [_wait_s(guesses, str(n)) for n in range(FREE_GUESSES)] == [0] * FREE_GUESSES
    waits = []
    for n in range(8):
        waits.append(_wait_s(guesses, f"more {n}"))
        clock.now_s += waits[-1]
        assert _wait_s(guesses, f"more {n}") == 0
    assert waits == [1, 2, 4, 8, 16, 30, 30, 30]
    assert max(waits) == LONGEST_WAIT_S


def test_ten_thousand_pins_take_days(guesses, clock):
    begun_s = clock.now_s
    for n in range(10_000):
        clock.now_s += _wait_s(guesses, f"{n:04d}")
        assert _wait_s(guesses, f"{n:04d}") == 0
    assert clock.now_s - begun_s > 3 * 86_400


def test_others_do_not_wait_and_who_is_right_starts_anew(guesses):
    for n in range(FREE_GUESSES):
        guesses.admit("Ada", str(n))
    assert _wait_s(guesses, "right") == 1
    assert _wait_s(guesses, "right", "Ben") == 0
    guesses.accept("Ada")
    assert [_wait_s(guesses, str(n)) for n in range(FREE_GUESSES)] == [0] * FREE_GUESSES


def test_the_same_guess_again_neither_counts_nor_waits(guesses):
    assert [_wait_s(guesses, "old") for _ in range(100)] == [0] * 100
    for n in range(FREE_GUESSES - 1):
        guesses.admit("Ada", str(n))
    assert (_wait_s(guesses, "another"), _wait_s(guesses, "old")) == (1, 0)


def test_after_a_quarter_of_an_hour_all_is_forgotten(guesses, clock):
    for n in range(FREE_GUESSES):
        guesses.admit("Ada", str(n))
    clock.now_s += 901
    assert [_wait_s(guesses, f"later {n}") for n in range(FREE_GUESSES)] == [0] * FREE_GUESSES


@pytest.mark.parametrize(
    ("address", "network"),
    [
        ("192.0.2.7", "192.0.2.7"),
        ("::ffff:192.0.2.7", "192.0.2.7"),
        ("2001:db8:1:2:3:4:5:6", "2001:db8:1:2::/64"),
        ("2001:db8:1:2::", "2001:db8:1:2::/64"),
        ("", ""),
    ],
)
def test_a_client_with_many_addresses_is_one(address, network):
    assert client_network(address) == network


@pytest.fixture
def actions(tmp_path):
    """What is asked of a station where Ada has a PIN, and Ben none."""
    file = tmp_path / "bench.toml"
    listed = '[[gate.operators]]\nname = "Ada"\npin = "{}"\n\n[[gate.operators]]\nname = "Ben"\n'
    text = open_document(DocumentKind.STATION, "simulated").text
    file.write_text(f'{text}\n[gate]\noperator = "refuse"\n\n{listed.format(hash_pin("4711"))}')
    watch = SimpleNamespace(served=load_stations([str(file)], [])[0])
    return Actions(SimpleNamespace(stations={"bench": watch}), SimpleNamespace())


def test_made_up_names_do_not_push_out_the_guesses_at_an_operator(actions, monkeypatch):
    monkeypatch.setattr("cbsr_qa.web.guesses._MAX_GUESSERS", 3)

    def guess(operator, pin):
        return run_coroutine(actions.count_pin("bench", operator, pin))

    for n in range(FREE_GUESSES):
        guess("Ada", f"{n:04d}")
    for n in range(20):
        assert guess(f"nobody {n}", "0000") == ("bench", f"nobody {n}")  # nothing to guess: never slowed down
        guess("Ben", f"{n:04d}")
    with pytest.raises(TooManyGuessesError):
        guess("Ada", "4711")
