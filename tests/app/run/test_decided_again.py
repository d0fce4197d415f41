"""A stored verdict that does not follow from its measurements is refused, naming the measurement."""

from dataclasses import replace
from datetime import UTC, datetime
from importlib.metadata import version
from types import SimpleNamespace

import pytest

from cbsr_qa.analysis.evaluate import judge
from cbsr_qa.app.run.decided_again import check_decided
from cbsr_qa.domain.errors import StoreError
from cbsr_qa.domain.plan.limits import Bound, Limit, Outcome
from cbsr_qa.domain.results.measurement import Measurement, Verdict, decide
from cbsr_qa.domain.run.run import ChainState
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.store.results.analyses import StoredAnalysis

LIMITS = (
    Limit("position_error", "mm", None, 5.0, 0.5, version="7"),
    Limit("settling_time", "s", None, 60.0),
    Limit("drift", "%", 0.0, 1.0),
)
MEASURED = (
    Measurement("position_error", 3.0, "mm", phase="grid", location="L1"),
    Measurement("position_error", 4.8, "mm", phase="grid", location="L2"),
    Measurement("settling_time", 70.0, "s", bound=Bound.LOWER),
    Measurement("noise", 0.1, "1"),
)
JUDGED = judge(MEASURED, [replace(limit, version="") for limit in LIMITS])
CHAINED, UNCHAINED = ChainState("chained"), ChainState()


def checked(
    measurements=JUDGED, verdict=None, *, chain=CHAINED, end=EndReason.FINISHED, software=None, limits=LIMITS
):
    told = verdict or decide(measurements)
    versions = (("cbsr-qa", software or version("cbsr-qa")),)
    now = datetime(2026, 11, 22, tzinfo=UTC)
    stored = StoredAnalysis("A", "R", now, versions, told, measurements, (), (), None, "", "equal", None)
    check_decided(SimpleNamespace(chain=chain, end=end), stored, LIMITS)


def changed(number, **values):
    return tuple(replace(m, **values) if k == number else m for k, m in enumerate(JUDGED))


LOOSER = replace(JUDGED[0].limit, upper=9.0)
REFUSED = {
    "an outcome": (
        {"measurements": changed(0, value=7.1)},
        r"measurement 0 \(position error \(L1\), phase grid\) states pass; its value 7.1 mm and limit at most 5 and"
        r" marginal within 0.5 mm say fail",
    ),
    "a marginal one": ({"measurements": changed(1, outcome=Outcome.PASS)}, "measurement 1 .* say marginal"),
    "a lower bound": ({"measurements": changed(2, bound=Bound.EXACT, value=10.0)}, "measurement 2 .* say pass"),
    "a limit": (
        {"measurements": changed(0, limit=LOOSER)},
        "measurement 0 .* states the limit at most 9 .*; its configuration says at most 5 ",
    ),
    "no limit": (
        {"measurements": changed(0, limit=None, outcome=Outcome.NOT_JUDGED)},
        "states the limit none; its configuration says at most 5",
    ),
    "a measurement less": ({"measurements": JUDGED[:-1]}, "no measurement is stored for the .* limit of drift"),
    "a verdict": ({"verdict": Verdict(Outcome.PASS, "all is well")}, "the verdict states pass .* say fail"),
    "a reason": ({"verdict": Verdict(Outcome.FAIL, "somebody said so")}, "states fail .somebody said so."),
    "an end": ({"end": EndReason.ABORTED, "verdict": Verdict(Outcome.PASS, "")}, "the run was aborted"),
    "nothing": ({"measurements": (), "verdict": Verdict(Outcome.PASS, "")}, "the run holds no measurement"),
    "unchained, an outcome": (
        {"measurements": changed(0, value=7.1), "chain": UNCHAINED},
        "measurement 0 .* states pass; its value 7.1 mm",
    ),
    "unchained, a verdict": (
        {"verdict": Verdict(Outcome.PASS, "all is well"), "chain": UNCHAINED},
        "the verdict states pass .* say fail",
    ),
}


@pytest.mark.parametrize(("change", "said"), REFUSED.values(), ids=REFUSED)
def test_what_does_not_follow_is_refused(change, said):
    with pytest.raises(StoreError, match=f"^run R: analysis A: .*{said}"):
        checked(**change)


@pytest.mark.parametrize(
    "change",
    [
        {},
        {"chain": UNCHAINED},
        {"verdict": Verdict(decide(JUDGED).outcome, "in the words of another version"), "software": "0.0.1"},
        {"measurements": changed(0, limit=LOOSER), "chain": UNCHAINED},  # configurations of before may read otherwise
        {"measurements": (), "verdict": Verdict(Outcome.NOT_MEASURED, "the frames cannot be imaged")},
        {"measurements": (), "verdict": Verdict(Outcome.NOT_MEASURED, "aborted"), "end": EndReason.ABORTED},
    ],
)
def test_what_follows_is_read(change):
    checked(**change)
