"""Outcomes of runs as JUnit XML, as Jenkins and other servers read it: a suite a run, a case a judged measurement."""

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC
from typing import BinaryIO, Final
from xml.etree.ElementTree import Element, SubElement, tostring

from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.results.listed import ListedRun
from cbsr_qa.domain.results.measurement import Measurement, describe_judgement
from cbsr_qa.domain.run.states import EndReason

_BEGIN: Final = b'<?xml version="1.0" encoding="UTF-8"?>\n<testsuites name="cbsr-qa">\n'
_END: Final = b"</testsuites>\n"
#: Characters that XML 1.0 does not allow.
_NO_XML: Final = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")

_ENDS: Final = {
    EndReason.RUNNING: "the run began and did not end",
    EndReason.ABORTED: "the run was aborted",
    EndReason.BROKEN: "the run broke off",
}
_PROPERTIES: Final = ("run", "serial", "batch", "sensor_type", "station", "recipe", "operator", "end", "verdict")


@contextmanager
def suites(file: BinaryIO) -> Iterator[None]:
    """Write what is around the suites."""
    file.write(_BEGIN)
    yield
    file.write(_END)


def suite(run: ListedRun, judged: Sequence[Measurement]) -> bytes:
    """Return the suite of one run.

    A value beyond its limit is a failure; one that could not be measured, a run that did not finish and a run without
    a result are errors. If the verdict was overridden to a pass, they are skipped, with the reason; if to a failure,
    the verdict itself is a case that failed.

    Parameters
    ----------
    judged : measurements with a limit, of the run's latest analysis.
    """
    begun_at = run.started_at.astimezone(UTC)  # a document reads alike wherever it is written
    name = f"{run.serial}, {begun_at:%Y-%m-%d %H:%M} UTC ({run.run})"
    element = Element("testsuite", name=_text(name))
    properties = SubElement(element, "properties")
    for name in _PROPERTIES:
        SubElement(properties, "property", name=name, value=_text(str(getattr(run, name) or "")))
    for name in ("parts", "failure_codes"):
        SubElement(properties, "property", name=name, value=_text("; ".join(map(str, getattr(run, name)))))
    results = Counter[str]()
    for name, kind, category, text in _cases(run, judged):
        # Recipe and sensor: servers take what is before the last dot for a package.
        classname = ".".join(_text(part).replace(".", "_") for part in (run.recipe, run.serial))
        case = SubElement(element, "testcase", classname=classname, name=_text(name))
        results[kind] += 1
        if kind in ("failure", "error"):
            SubElement(case, kind, message=_text(text), type=category).text = _text(text)
        elif kind == "skipped":
            SubElement(case, kind, message=_text(text))
        elif text:
            SubElement(case, "system-out").text = _text(text)
    counts = {"failures": results["failure"], "errors": results["error"], "skipped": results["skipped"]}
    element.attrib |= {"tests": str(results.total()), **{name: str(count) for name, count in counts.items()}}
    began = run.started_at.astimezone(UTC)
    element.attrib |= {"time": f"{run.station_s:.3f}", "timestamp": f"{began:%Y-%m-%dT%H:%M:%S}"}
    element.attrib |= {"hostname": _text(run.station), "id": run.run, "package": _text(run.recipe)}
    return tostring(element, encoding="unicode").encode() + b"\n"


def _cases(run: ListedRun, judged: Sequence[Measurement]) -> Iterator[tuple[str, str, str, str]]:
    """Yield each case: its name, what it is (empty for a pass), the kind of failure, and words."""
    if not run.finished:
        yield "run", "error", str(run.end), ": ".join(filter(None, (_ENDS[run.end], run.end_detail)))
        return
    if run.outcome is None:
        yield "run", "error", "no result", "the run is finished and has no result; cbsr-qa run --resume makes it"
        return
    override = "" if run.decision is None else f"overridden by {run.decision.operator}: {run.decision.why}"
    if override and run.verdict is Outcome.FAIL:
        yield "verdict", "failure", "override", override
    names = Counter[str]()
    for measurement in judged:
        strain = "" if measurement.strain is None else f"strain {100 * measurement.strain:.4g} %"
        name = ", ".join(part for part in (measurement.label, measurement.phase, strain) if part)
        names[name] += 1
        name = name if names[name] == 1 else f"{name} ({names[name]})"
        kind = {Outcome.FAIL: "failure", Outcome.NOT_MEASURED: "error"}.get(measurement.outcome, "")
        text = describe_judgement(measurement)
        if kind and override and run.passed:
            kind, text = "skipped", f"{override}; {text}"
        marginal = f"marginal: {text}" if measurement.outcome is Outcome.MARGINAL else ""
        yield name, kind, str(measurement.outcome), text if kind else marginal


def _text(text: str) -> str:
    return _NO_XML.sub("\ufffd", text)
