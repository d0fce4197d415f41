"""Report sections of recordings: they show what the result says, and nothing for runs."""

from dataclasses import replace

import numpy as np
import pytest
from board_files import BoardFile, counts
from recording_samples import sample_recording
from section_texts import blocks, tables, texts

from cbsr_qa.analysis.recording.analysis import analyse_recording
from cbsr_qa.domain.readings.frames import ReadOptions
from cbsr_qa.domain.results.report import Figure, Paragraph
from cbsr_qa_plugins.reconstruction.one_step import GaussNewtonNoser
from cbsr_qa_plugins.recordings.ert_board_csv import ErtBoardCsv
from cbsr_qa_plugins.sections.recording import RecordingChannels, RecordingEvents, RecordingRows

SECTIONS = [RecordingEvents(), RecordingChannels(), RecordingRows()]


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    """Sixteen frames of unrelated counts with a cut row and a dump: no image, one rejected row, one noted dump."""
    file = BoardFile().header().frames(counts(8)).log().frames(counts(9)[:8]).mark()
    file.lines[40] = file.lines[40][:60]
    path = file.save(tmp_path_factory.mktemp("board"))
    return analyse_recording(ErtBoardCsv().read(path, ReadOptions()), GaussNewtonNoser())


def words(section):
    said = [paragraph.text for paragraph in blocks(section, Paragraph)]
    return [*said, *(text for table in tables(section) for row in texts(table) for text in row)]


def test_no_event_is_said_with_its_reason(result):
    said = " ".join(words(SECTIONS[0].render(result)))
    assert result.events_why in said
    assert "not reciprocal" in said


@pytest.mark.parametrize(("r_over_R", "shown"), [(0.05, "centre"), (0.5, "7.00")])
def test_an_event_at_the_centre_has_no_electrode(r_over_R, shown):
    sample = sample_recording(1)
    event = replace(sample.events[0], x_over_R=r_over_R, y_over_R=0.0, electrode=7.0)
    table = tables(SECTIONS[0].render(replace(sample, events=(event,))))[0]
    assert texts(table)[0][table.columns.index("Electrode")] == shown


def test_channels_say_noise_and_reciprocity(result):
    said = words(SECTIONS[1].render(result))
    assert f"{result.channels.reciprocity_error:.3f}" in said
    assert np.isfinite(result.noise.rms)


@pytest.mark.parametrize(
    ("saturated", "said"), [((), "Saturated: none; stuck: none."), (((0, 0), (1, 1)), "Saturated: 2; stuck: none.")]
)
def test_the_map_counts_what_is_marked_on_it(result, saturated, said):
    marked = replace(result, channels=replace(result.channels, saturated=saturated, stuck=()))
    (figure,) = blocks(SECTIONS[1].render(marked), Figure)
    assert figure.caption == f"Level of each channel. {said}"


def test_rejected_rows_come_first_with_line_and_reason(result):
    (table,) = tables(SECTIONS[2].render(result))
    assert [cell.text for cell in table.rows[0]][:2] == ["41", "rejected"]
    assert "watchdog" in table.rows[-1][2].text
    assert "1 row rejected, 1 frame dropped" in table.caption


def test_runs_have_no_such_sections():
    assert all(section.render(object()) is None for section in SECTIONS)
