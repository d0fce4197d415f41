"""Effects of other people that fail: the scene is refused, and the effect to blame is named."""

import numpy as np
import pytest
from simulated_setting import HEAD, material, scene, sensor_type

from cbsr_qa.domain.errors import CbsrError, ConfigError, PluginError
from cbsr_qa.domain.plan.world import Moment, SceneSetting, SheetDesign, Transcript
from cbsr_qa.domain.readings.frames import ReadingFlag
from cbsr_qa.simulate.chain import build_chain

SETTING = SceneSetting(sensor_type(), material(), HEAD, seed=1, current_A=1e-3)
SHAPE = sensor_type().pattern.shape


def chain_of(effect):
    return build_chain(scene("theirs"), SETTING, lambda name: lambda setting: effect)


def theirs(stage, needs=(), **methods):
    return type("Theirs", (), {"perturbs": stage, "needs": needs, **methods})()


def breaks(self, *given):
    raise ZeroDivisionError("their slip")


def moment():
    one = Moment(SETTING, 12.5, 0, [], [0.1], [1.0])
    one.voltages, one.flags = np.ones(SHAPE), np.zeros(SHAPE, dtype=np.uint8)
    one.impedance_ohm, one.contact_mm, one.current_A = np.eye(16), np.ones(16), np.ones(SHAPE)
    return one


@pytest.mark.parametrize("error", [RuntimeError, KeyError, OSError, AssertionError])
def test_a_factory_that_fails_is_named(error):
    def factory(setting):
        raise error("their slip")

    with pytest.raises(ConfigError, match=f"effect 'theirs' cannot be created: {error.__name__}: .*their slip"):
        build_chain(scene("theirs"), SETTING, lambda name: factory)


@pytest.mark.parametrize(
    ("effect", "said"),
    [
        (object(), "perturbs = None"),
        (theirs(["force"], apply=breaks), r"perturbs = \['force'\]"),
        (theirs("force", needs="piezoresistivity", apply=breaks), "needs = 'piezoresistivity'"),
        (theirs("force", needs=None, apply=breaks), "needs = None"),
        (theirs("force", after=(3,), apply=breaks), r"after = \(3,\)"),
        (theirs("sheet", apply=breaks), "lacks the method for it"),
        (theirs("voltages", design=breaks), "lacks the method for it"),
    ],
)
def test_an_effect_that_does_not_say_what_it_is_is_refused(effect, said):
    with pytest.raises(ConfigError, match=f"effect 'theirs' .*{said}") as refused:
        chain_of(effect)
    assert refused.value.remedy


def test_a_factory_that_nothing_can_be_given_is_refused():
    with pytest.raises(CbsrError, match="effect 'theirs'"):
        build_chain(scene("theirs"), SETTING, lambda name: 3)


@pytest.mark.parametrize("stage", ["position", "response", "impedance", "voltages", "force"])
def test_an_effect_that_fails_at_a_moment_is_named_with_the_moment(stage):
    with pytest.raises(PluginError, match=r"effect 'theirs' failed at 12.5 s: ZeroDivisionError: their slip"):
        chain_of(theirs(stage, apply=breaks)).apply(stage, moment())


def test_an_effect_that_fails_on_the_sheet_the_transcript_or_its_steps_is_named():
    with pytest.raises(PluginError, match="effect 'theirs' failed: ZeroDivisionError"):
        chain_of(theirs("sheet", design=breaks)).design(SheetDesign.make_uniform(sensor_type(), HEAD))
    with pytest.raises(PluginError, match="effect 'theirs' failed: ZeroDivisionError"):
        chain_of(theirs("recording", record=breaks)).record(Transcript.complete(SETTING, np.arange(3.0)))
    switching = theirs("impedance", apply=lambda self, moment: None, switches=breaks)
    with pytest.raises(PluginError, match="effect 'theirs' failed: ZeroDivisionError"):
        chain_of(switching).switches(moment(), 0.0, 1.0)


def test_what_an_effect_refuses_stays_its_own_words():
    def refuses(self, moment):
        raise ConfigError("too hot", remedy="cool it")

    with pytest.raises(ConfigError, match=r"^too hot\ncool it$"):
        chain_of(theirs("force", apply=refuses)).apply("force", moment())


@pytest.mark.parametrize(
    ("stage", "attribute", "value"),
    [
        ("position", "place_mm", (np.nan, 0.0)),
        ("geometry", "surface_mm", np.inf),
        ("response", "response", [np.nan]),
        ("stress", "stress_kPa", [-np.inf]),
        ("contacts", "contact_mm", np.full(16, np.nan)),
        ("impedance", "impedance_ohm", np.full((16, 16), np.inf)),
        ("source", "current_A", np.full(SHAPE, np.nan)),
        ("voltages", "voltages", np.full(SHAPE, np.nan)),
        ("force", "force_N", np.nan),
    ],
)
def test_an_effect_that_leaves_no_number_is_named(stage, attribute, value):
    effect = theirs(stage, apply=lambda self, moment: setattr(moment, attribute, value))
    with pytest.raises(
        PluginError, match=rf"effect 'theirs' leaves .*{attribute}.* with non-finite values at 12.5 s"
    ):
        chain_of(effect).apply(stage, moment())


def test_a_reading_that_is_flagged_as_missing_need_be_no_number():
    def loses(self, moment):
        moment.voltages[3, 5], moment.flags[3, 5] = np.nan, ReadingFlag.MISSING.value

    one = moment()
    chain_of(theirs("voltages", apply=loses)).apply("voltages", one)
    assert np.isnan(one.voltages).sum() == 1
