"""Options of plugins: one table of what their models refuse, and every built-in plugin against the same door."""

import math
from typing import Annotated, Literal

import pytest
from pydantic import Field

from cbsr_qa.domain.errors import ConfigError, RefusedError
from cbsr_qa.domain.plan.plan import PluginChoice
from cbsr_qa.plugin.creation import create_plugin
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.plugin.hooks import Kind
from cbsr_qa.plugin.options import Array, PluginOptions, WithOptions, options_of
from cbsr_qa.plugin.problems import Problem, describe_allowed


class Place(PluginOptions):
    x_mm: float


class Motion(PluginOptions):
    speed_mm_per_min: float
    homing_s: float = 60.0


class Head(PluginOptions):
    diameter_mm: float | None = None
    outline_mm: list[float] | None = None


class Probe(WithOptions):
    class Options(PluginOptions):
        from_s: Annotated[float, Field(gt=0, lt=3600)] = 5.0
        count: Annotated[int, Field(ge=1, le=10)] = 3
        highest: Annotated[float, Field(le=7)] = 1.0
        every: bool = False
        order: Literal["rising", "falling", "random"] = "rising"
        pair: Annotated[tuple[float, float], Array] = (0.0, 1.0)
        strains: Annotated[tuple[Annotated[float, Field(ge=1, le=60)], ...], Array, Field(min_length=2)] = (1.0, 2.0)
        places: Annotated[tuple[Place, ...], Array] = ()
        word: Annotated[str, Field(min_length=1)] = "R"
        port: Annotated[str | None, Field(description="a serial port")] = None

        def problems(self):
            if self.highest < self.count:
                yield Problem(("highest",), f"is {self.highest:g}, below count", f"it must be at least {self.count}")

    options: Options


@pytest.mark.parametrize(
    ("given", "reason", "remedy"),
    [
        ({"from_s": 0}, "from_s is 0", "it must be a number above 0 and below 3600"),
        ({"from_s": "5 s"}, "from_s is '5 s'", "it must be a number above 0 and below 3600"),
        ({"from_s": True}, "from_s is True", "it must be a number above 0 and below 3600"),
        ({"from_s": math.nan}, "from_s is nan", "it must be a finite number above 0 and below 3600"),
        ({"from_s": 10**400}, "from_s is a whole number beyond 1.8e308", "it must be a number above 0"),
        ({"from_s": 10**6000}, "from_s is a whole number beyond 1.8e308", "it must be a number above 0"),
        ({"count": 0}, "count is 0", "it must be a whole number from 1 to 10"),
        ({"count": 3.0}, "count is 3.0", "it must be a whole number from 1 to 10"),
        ({"highest": 8}, "highest is 8", "it must be a number of at most 7"),
        ({"every": 1}, "every is 1", "it must be true or false"),
        ({"order": "up"}, "order is 'up'", "it must be 'rising', 'falling' or 'random'"),
        ({"pair": [1]}, "pair is [1]", "it must be an array of 2, each a number"),
        ({"pair": 1}, "pair is 1", "it must be an array of 2, each a number"),
        ({"pair": [1, "x"]}, "pair[2] is 'x'", "it must be a number"),
        ({"strains": [3]}, "strains is [3]", "it must have at least 2 items"),
        ({"strains": [3, 0]}, "strains[2] is 0", "it must be a number from 1 to 60"),
        ({"places": [{"x_mm": 1}, {}]}, "places[2].x_mm is missing", "it must be a number"),
        ({"places": [{"x_cm": 1, "x_mm": 1}]}, "places[1].x_cm is not a known key", "did you mean 'x_mm'?"),
        ({"word": ""}, "word is ''", "it must have at least 1 character"),
        ({"port": 3}, "port is 3", "it must be a serial port"),
        ({"form_s": 3}, "form_s is not a known key", "did you mean 'from_s'? allowed here: count, every, from_s"),
        ({"from": 3}, "from is not a known key", "did you mean 'from_s'?"),
        ({"highest": 2.0}, "highest is 2, below count", "it must be at least 3"),
        ({"every": 1, "highest": 2.0}, "every is 1; highest is 2, below count", "every: it must be true or false"),
    ],
)
def test_a_wrong_option_is_refused_with_what_is_allowed(given, reason, remedy):
    with pytest.raises(ConfigError) as refused:
        Probe(**{"highest": 4.0} | given)
    assert refused.value.reason.startswith(reason)
    assert refused.value.remedy.startswith(remedy)


def test_options_are_read_once_with_their_defaults():
    probe = Probe(highest=4, pair=[1, 2], places=[{"x_mm": 3}])
    assert (probe.options.highest, probe.options.pair, probe.options.places[0].x_mm) == (4.0, (1.0, 2.0), 3.0)
    assert probe.options.from_s == 5.0


def test_what_a_field_takes_is_worded_from_its_type():
    assert (
        describe_allowed(Probe.Options.model_fields["strains"])
        == "an array of at least 2, each a number from 1 to 60"
    )
    assert describe_allowed(Probe.Options.model_fields["places"]) == "an array, each a table of x_mm"
    assert describe_allowed(Annotated[float, Field(ge=0, lt=1)]) == "a number of at least 0 and below 1"
    assert describe_allowed(Annotated[float, Field(lt=1)]) == "a number below 1"
    assert describe_allowed(Motion) == "a table of speed_mm_per_min (optional: homing_s)"
    assert describe_allowed(dict[str, Motion]) == f"one named table or more, each {describe_allowed(Motion)}"
    assert (
        describe_allowed(Head) == "a table of diameter_mm, outline_mm"
    )  # neither alone is needed: a rule of the table's says so


def test_keyword_arguments_are_options_where_a_factory_has_no_model():
    def factory(setting, *, needed, spare=1):
        return setting, needed, spare

    model = options_of(factory, handed=1)
    with pytest.raises(ConfigError, match="needed is missing"):
        model.read({})
    with pytest.raises(ConfigError, match="neded is not a known key"):
        model.read({"needed": 1, "neded": 1})
    options_of(lambda **anything: None).read({"anything": 3})


PLUGINS = discover()


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        (r.kind, r.name)
        for r in PLUGINS.registrations()
        if r.kind in (Kind.METRIC, Kind.SEQUENCE, Kind.RECONSTRUCTION, Kind.RECORDING, Kind.SECTION)
    ],
)
def test_every_plugin_refuses_an_option_it_does_not_have_by_its_name(kind, name):
    with pytest.raises(RefusedError, match=rf"somewhere: {kind} '{name}'.*phase_of_the_moon") as refused:
        create_plugin(PLUGINS, kind, PluginChoice(name, {"phase_of_the_moon": 1}), "somewhere")
    assert refused.value.remedy
