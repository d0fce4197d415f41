"""Instruments that an operator works: what is asked, what is taken for an answer, and when a reading is due."""

import re
from dataclasses import replace

import pytest
from simulated_setting import HEAD, MOTION, material, sensor_type

from cbsr_qa.domain.errors import AbortedError, ConfigError, InstrumentError
from cbsr_qa.domain.plan.plan import InstrumentSpec
from cbsr_qa.domain.plan.steps import AcquireFrames, FindSurface, Hold, Home, Press, Release
from cbsr_qa.domain.readings.loads import Load
from cbsr_qa.domain.run.events import LoadFinished, SamplesTaken
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.plugin.instruments import StationContext
from cbsr_qa.station.bench import Bench, Mounted
from cbsr_qa.station.execution import execute
from cbsr_qa.system.clock import VirtualClock
from cbsr_qa.testing.bench import Script, ScriptedApplicator, ScriptedFrames, example_identity, example_plan
from cbsr_qa_plugins.hardware.manual_applicator import open_applicator
from cbsr_qa_plugins.hardware.manual_samplers import open_load_cell, open_thermometer

PLAN = example_plan(())
STALE_S = 60.0
ANSWER_S = 8.0
SPEED = MOTION.press_speed_mm_s


class Person:
    """An operator with a stand: does what is asked, in some seconds, and reads a spring of 2 N/mm under the head."""

    def __init__(self, clock, *, surface_mm=24.9, tare=0.5):
        self.clock = clock
        self.surface_mm, self.tare = surface_mm, tare
        self.scale_mm = 0.0
        self.asked, self.answers = [], []

    def __call__(self, text):
        self.asked.append(text)
        self.clock.sleep(ANSWER_S)
        if self.answers:
            return self.answers.pop(0)
        if "the depth" in text:
            return f"{self.surface_mm} mm"
        if "on the scale" in text:
            self.scale_mm = float(re.search(r"([\d.]+) mm on the scale", text).group(1))
            return ""
        if "read the load cell" in text:
            return f"{self.tare + 2 * max(self.scale_mm - self.surface_mm, 0.0):.3f}"
        self.scale_mm = 0.0
        return ""


def told(role, clock, ask, **options):
    safety = replace(PLAN.safety, stale_s=STALE_S)
    return StationContext(
        role, clock, sensor_type(), material(), HEAD, 1, options, motion=MOTION, safety=safety, ask=ask
    )


@pytest.fixture
def person():
    return Person(VirtualClock())


@pytest.fixture
def head(person):
    return open_applicator(told("head", person.clock, person))


@pytest.fixture
def cell(person, head):
    made = open_load_cell(told("cell", person.clock, person, unit="N", capacity=50))
    made.link({"force_applicator": head})
    return made


def test_they_are_no_simulation(head, cell):
    assert not head.identity().simulated
    assert not cell.identity().simulated


# --- the head ---


def test_every_movement_is_asked_for_in_words(person, head):
    head.home()
    head.move_to(10.0, -5.0)
    head.press(0.8, SPEED)
    head.release()
    home, place, press, lift = person.asked
    assert "head: lift the head to 25 mm above the sheet, bring it over the sheet's centre" in home
    assert "x = 10 mm, y = -5 mm" in place
    assert "go to 0.8 mm below the surface at 40 mm/min: 25.80 mm on the scale" in press
    assert "lift the head straight up" in lift


def test_nothing_is_asked_twice(person, head):
    head.home()
    head.move_to(0.0, 0.0)
    head.release()
    assert len(person.asked) == 1


def test_depths_count_from_the_surface_that_was_found(person, head):
    head.home()
    assert head.find_surface(10.0, 0.0) == 24.9
    head.press(0.8, SPEED)
    assert person.scale_mm == 25.7
    head.move_to(12.0, 0.0)  # the surface found nearest counts where none was
    head.press(0.8, SPEED)
    assert person.scale_mm == 25.7
    head.home()  # the scale has a new zero
    head.press(0.8, SPEED)
    assert person.scale_mm == 25.8


def test_a_head_that_is_down_is_lifted_before_it_travels(person, head):
    head.home()
    head.press(0.8, SPEED)
    assert head.down
    person.asked.clear()
    head.move_to(5.0, 5.0)
    assert ["lift" in text for text in person.asked] == [True, False]
    assert not head.down


def test_a_depth_beside_the_one_asked_for_is_asked_for_again(person, head):
    head.home()
    person.answers = ["25.5", "25.79"]
    head.press(0.8, SPEED)
    assert "25.5 mm is -0.30 mm off; go straight to 0.8 mm" in person.asked[-1]
    person.answers = ["25.5"] * 5
    with pytest.raises(InstrumentError, match=r"told to be at 26\.20 mm on its scale and was last at 25\.50 mm"):
        head.press(1.2, SPEED)
    assert head.down


@pytest.mark.parametrize("nonsense", ["", "deep", "1,5", "nan", "inf", "-3", "1e9", "24.9 N"])
def test_nonsense_is_refused_and_asked_again(person, head, nonsense):
    head.home()
    person.answers = [nonsense, "24.7 mm"]
    assert head.find_surface(0.0, 0.0) == 24.7
    assert "from 0.001 to 50 [mm]:" in person.asked[-1]


def test_after_enough_nonsense_the_step_fails(person, head):
    person.answers = ["", *["no"] * 5]
    with pytest.raises(InstrumentError, match="head at the operator: 5 answers were not a number of mm"):
        head.find_surface(0.0, 0.0)
    # Nobody said that it is up again.
    with pytest.raises(InstrumentError, match="LIFT IT NOW"):
        head.safe_state()


def test_the_safe_state_of_a_head_that_is_down_is_asked_of_nobody_and_not_claimed(person, head):
    head.home()
    head.safe_state()
    head.press(0.8, SPEED)
    person.asked.clear()
    for _ in range(2):
        with pytest.raises(InstrumentError, match="LIFT IT NOW"):
            head.safe_state()
    assert person.asked == []
    head.release()
    head.safe_state()


def test_an_operator_who_stops_ends_the_run(person, head):
    def stopping(text):
        raise AbortedError("the operator")

    head._operator._ask = stopping
    with pytest.raises(AbortedError):
        head.home()


# --- the load cell ---


def test_the_first_reading_is_the_tare_and_compression_is_positive(person, head, cell):
    block = cell.samples_since(0.0)
    assert (block.channel, block.unit, block.values.tolist()) == ("force", "N", [0.0])
    assert block.time_s.tolist() == [ANSWER_S]
    head.home()
    head.press(0.8, SPEED)
    block = cell.samples_since(block.time_s[-1])
    assert block.values.tolist() == pytest.approx([2 * (25.8 - 24.9)])
    assert "the head is down, compression positive [N]" in person.asked[-1]


def test_grams_become_newtons(person, head):
    cell = open_load_cell(told("cell", person.clock, person, unit="g", capacity=750, tare=False))
    cell.link({"force_applicator": head})
    person.answers = ["100 g"]
    assert cell.samples_since(0.0).values.tolist() == pytest.approx([0.980665])


def test_a_reading_is_asked_for_after_every_order_and_not_besides(person, head, cell):
    def asked():
        before = len(person.asked)
        block = cell.samples_since(person.clock.now())
        return len(person.asked) - before, len(block)

    assert asked() == (1, 1)
    assert asked() == (0, 0)
    person.clock.sleep(600.0)  # the head is up: nobody is asked every minute for nothing
    assert asked() == (0, 0)
    for order in (head.home, lambda: head.move_to(0.0, 0.0), lambda: head.press(0.8, SPEED), head.release):
        order()
        assert asked() == (1, 1)
        assert asked() == (0, 0)


def test_while_the_head_is_down_a_reading_is_due_before_it_is_stale(person, head, cell):
    head.press(0.8, SPEED)
    cell.samples_since(0.0)
    person.clock.sleep(STALE_S / 2)
    assert len(cell.samples_since(person.clock.now())) == 0
    person.clock.sleep(1.0)
    assert len(cell.samples_since(person.clock.now() - 1e-9)) == 1


def test_a_reading_beyond_the_cell_is_asked_again(person, cell):
    person.answers = ["51", "-50.1", "0.4"]
    cell.samples_since(0.0)
    assert "-50.1 N is not within its bounds" in person.asked[-1]


@pytest.mark.parametrize("kind", [ScriptedApplicator, None])
def test_a_head_that_moves_by_itself_needs_a_cell_that_samples_by_itself(person, kind):
    cell = open_load_cell(told("cell", person.clock, person, unit="N", capacity=50))
    peers = {} if kind is None else {"force_applicator": kind(Script(person.clock))}
    with pytest.raises(ConfigError, match="for a head that is moved by hand"):
        cell.link(peers)


def test_without_an_operator_they_are_refused(person):
    for opener, options in ((open_applicator, {}), (open_load_cell, {"unit": "N", "capacity": 50})):
        with pytest.raises(ConfigError, match="operated by hand, and there is no operator to ask") as raised:
            opener(told("one", person.clock, None, **options))
        assert "terminal" in raised.value.remedy


# --- the thermometer ---


@pytest.mark.parametrize(("limits_C", "every_s"), [(None, 1800.0), ((15.0, 30.0), 180.0)])
def test_a_temperature_is_asked_for_before_it_is_too_old(person, head, limits_C, every_s):
    context = told("room", person.clock, person)
    one = open_thermometer(replace(context, safety=replace(context.safety, temperature_C=limits_C)))
    one.link({"force_applicator": head})
    person.answers = ["warm", "21.5 °C", "22"]
    block = one.samples_since(0.0)
    assert (block.channel, block.unit, block.values.tolist()) == ("temperature", "°C", [21.5])
    person.clock.sleep(every_s - 1)
    assert len(one.samples_since(block.time_s[0])) == 0
    person.clock.sleep(1)
    assert one.samples_since(block.time_s[0]).values.tolist() == [22.0]
    assert len(person.asked) == 3


def test_a_thermometer_read_by_hand_needs_a_head_moved_by_hand(person):
    one = open_thermometer(told("room", person.clock, person, every_min=1))
    with pytest.raises(ConfigError, match="a thermometer that is read by an operator is for a head that is moved"):
        one.link({"force_applicator": ScriptedApplicator(Script(person.clock))})


# --- a run ---

STEPS = (
    Home(),
    AcquireFrames(2),
    FindSurface(0.0, 0.0),
    Press(Load("one", 10.0, 5.0, 0.2, 0)),
    Hold(100.0, acquire=True),
    Release(),
    Hold(300.0, acquire=False),
)


def run(person):
    clock = person.clock
    plan = example_plan(STEPS)
    plan = replace(plan, safety=replace(plan.safety, stale_s=STALE_S))
    head = open_applicator(told("head", clock, person))
    cell = open_load_cell(told("cell", clock, person, unit="N", capacity=50))
    frames = ScriptedFrames(Script(clock), plan.sensor_type.pattern.shape, 2.5)
    mounted = [
        Mounted(InstrumentSpec(role, "any", (role,), {}, None), one)
        for role, one in (("force_applicator", head), ("frame_source", frames), ("force", cell))
    ]
    documents = []
    return execute(plan, example_identity(), Bench(mounted), clock, [documents.append]), documents


def test_a_whole_run_by_hand(person):
    ended, documents = run(person)
    assert ended.end is EndReason.FINISHED, ended.detail
    assert sum(isinstance(event, LoadFinished) for event in documents) == 1
    forces = [event.samples.values for event in documents if isinstance(event, SamplesTaken)]
    assert all(len(values) == 1 for values in forces)
    # Down for 100 s: read when it got there, and again each time more than half a minute had passed.
    pressed = [values[0] for values in forces if values[0] > 1]
    assert pressed == pytest.approx([2 * 0.8] * len(pressed))
    assert 3 <= len(pressed) <= 4


def test_a_cell_that_shows_too_much_stops_the_run_and_says_that_the_head_is_down(person):
    class Heavy(Person):
        def __call__(self, text):
            if "the head is down" in text:
                return "30"
            return super().__call__(text)

    ended, _ = run(Heavy(person.clock))
    assert ended.end is EndReason.BROKEN
    assert "rule 'force': 29.5 N measured by" in ended.detail
    assert "NOT SAFE" in ended.detail
    assert "LIFT IT NOW" in ended.detail
