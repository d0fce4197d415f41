"""Every event of a run as a document: complete, plain JSON, as its schema says."""

import json
import re
from dataclasses import asdict, fields
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from pages import blocks
from pydantic import TypeAdapter
from stored_runs import force, frames, record, short_run

from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.plan.steps import AcquireFrames, Press
from cbsr_qa.domain.readings.frames import ReadingFlag, SampleBlock
from cbsr_qa.domain.readings.loads import Load
from cbsr_qa.domain.run.event_documents import EventDocument, EventMessage, event_document
from cbsr_qa.domain.run.events import FramesTaken, LoadFinished, RunConcluded, RunEvent, SamplesTaken, StepStarted
from cbsr_qa.domain.run.states import EndReason


def test_the_events_of_a_run_are_all_documented():
    assert {type(event) for event in short_run("run-1")} == set(get_args(RunEvent))
    assert len(get_args(EventDocument)) == len(get_args(RunEvent)) + 1  # and the verdict


CONCLUDED = RunConcluded(
    EndReason.FINISHED, Outcome.PASS, "all limits are met", "var/reports/S-1.html", "var/calibrations/S-1.h5"
)


@pytest.mark.parametrize("event", [*short_run("run-1"), CONCLUDED], ids=lambda event: type(event).__name__)
def test_a_document_has_the_keys_of_its_schema_and_survives_json(event):
    document = event_document(event)
    assert json.loads(json.dumps(document, allow_nan=False)) == document
    read = TypeAdapter(EventDocument).validate_python(document)
    assert "".join(word.title() for word in document["type"].split("_")) == type(event).__name__
    whole = asdict(read, dict_factory=lambda pairs: {key: value for key, value in pairs if value is not None})
    assert json.loads(json.dumps(whole)) == document


def test_a_run_is_named_and_traced_by_its_first_event():
    document = event_document(short_run("run-1", serial="S-9")[0])
    assert (document["run"], document["serial"], document["batch"]) == ("run-1", "S-9", "B7")
    assert document["started_at"] == "2026-11-21T08:00:00.123456+00:00"
    assert document["software"] == {"cbsr-qa": "0.1.0", "numpy": "2.0"}
    assert [each["role"] for each in document["instruments"]] == ["smu", "applicator"]


def test_frames_and_samples_are_summarised():
    block = frames(4.0, 8)
    block.flags[:] = 0
    block.flags[3, 2, 1] = ReadingFlag.SATURATED
    assert event_document(FramesTaken(1, block)) == {
        "type": "frames_taken", "phase": 1, "count": 8, "readings": 256, "unusable": 1,
        "first_s": 4.0, "time_s": 21.5,
    }  # fmt: skip
    values = force(4.0).values
    document = event_document(SamplesTaken(1, force(4.0)))
    assert (document["smallest"], document["largest"], document["last"]) == (min(values), max(values), values[-1])


def test_values_that_json_does_not_have_are_left_out():
    values = np.array([1.0, np.nan])
    document = event_document(SamplesTaken(0, SampleBlock("force", "N", np.array([0.0, 1.0]), values)))
    assert (document["count"], document["time_s"], document["last"]) == (2, 1.0, 1.0)
    empty = event_document(SamplesTaken(0, SampleBlock("force", "N", np.array([]), np.array([]))))
    assert empty == {"type": "samples_taken", "phase": 0, "channel": "force", "unit": "N", "count": 0}


def test_a_step_says_its_kind_and_what_belongs_to_it():
    counted = event_document(StepStarted(0, 4, AcquireFrames(np.int64(3)), 1.0, 2.0))
    assert counted["step"] == {"kind": "acquire_frames", "count": 3}
    pressed = event_document(StepStarted(0, 5, Press(Load("R1", 1.0, -2.0, 0.1, 2)), 1.0, 2.0))
    assert pressed["step"] == {"kind": "press", "label": "R1", "x_mm": 1.0, "y_mm": -2.0, "strain": 0.1, "trial": 2}


def test_a_load_is_finished_when_its_rest_has_ended():
    document = event_document(LoadFinished(0, record(3, 30.0)))
    assert (document["index"], document["trial"], document["label"]) == (3, 3, "L0")
    assert (document["press_start_s"], document["clear_s"], document["time_s"]) == (30.0, 91.25, 152.0)


def test_the_reference_shows_a_message_and_an_example_of_every_event():
    page = Path(__file__).parents[3] / "docs" / "reference" / "events.md"
    message, *examples = [json.loads(block) for block in blocks(page, "json")]
    assert list(message) == [field.name for field in fields(EventMessage)]
    TypeAdapter(EventMessage).validate_python(message)
    real = {document["type"]: document for document in map(event_document, [*short_run("run-1"), CONCLUDED])}
    assert [example["type"] for example in examples] == re.findall(
        r"`(\w+)`", "".join(re.findall(r"^### .*", page.read_text(), re.M))
    )
    assert {example["type"] for example in examples} == set(real)
    for example in examples:
        TypeAdapter(EventDocument).validate_python(example)
        assert example.keys() == real[example["type"]].keys()
