"""``cbsr-qa analyse --reconstruction``: any method, on presses whose places are known."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from board_files import BoardFile
from pressed_files import exported, pressed_frames
from tiers import rest_but_named

from cbsr_qa.analysis.recording.analysis import AnalysisChoices, analyse_recording
from cbsr_qa.analysis.recording.images import EventImages, Sighting, frames_around, nearest_frames
from cbsr_qa.analysis.recording.places import Place
from cbsr_qa.app.analyse.analyse import analyse_file
from cbsr_qa.app.analyse.request import AnalyseRequest
from cbsr_qa.cli.main import run_guarded
from cbsr_qa.domain.errors import NumericsError, PluginError
from cbsr_qa.domain.goodness import Goodness
from cbsr_qa.domain.imaging import LinearReconstruction, ParameterChoice
from cbsr_qa.domain.plan.plan import PluginChoice
from cbsr_qa.domain.readings.frames import FrameBlock, ReadOptions, Recording, ScanKind, VoltageUnit
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.plugin.hooks import Kind
from cbsr_qa.report.document import json_document
from cbsr_qa_plugins.reconstruction.one_step import GaussNewtonNoser
from cbsr_qa_plugins.recordings.cbsr_recording import CbsrRecording

PRESSED = (0.4, 0.3)
METHODS = discover().names(Kind.RECONSTRUCTION)
#: One that is the default, one of a raster, one that iterates; tests/plugins/reconstruction has each method's own.
FIRST = ("gauss-newton-noser", "linear-back-projection", "absolute-gauss-newton")
#: Distance of an image's centre of mass from the press, of the radius. Images pull, the coarse rasters most.
TOLERANCE = 0.05
COARSER = {"linear-back-projection": 0.12, "pyeit-greit": 0.1, "pyeit-jac": 0.08, "truncated-svd": 0.07}
CRITERIA = {"noise-figure", "gcv", "l-curve", "discrepancy", "given", "none"}


@pytest.fixture(autouse=True)
def own_var(tmp_path, monkeypatch):
    monkeypatch.setenv("CBSR_QA_VAR", str(tmp_path / "var"))


@pytest.fixture(scope="module")
def pressed(tmp_path_factory):
    return exported(tmp_path_factory.mktemp("pressed"), pressed_frames(*PRESSED, contrast=-0.1))


@pytest.fixture(scope="module")
def two_at_once(tmp_path_factory):
    """A press that lasts beside another one."""
    frames = pressed_frames(0.5, 0.1, contrast=-0.1, start=20, end=70)
    other = pressed_frames(-0.5, 0.1, contrast=-0.1, start=40, end=60, seed=2)
    still = pressed_frames(0.0, 0.0, contrast=0.0, seed=3)
    return exported(tmp_path_factory.mktemp("two"), frames + other - still)


def run(capsys, *arguments):
    code = run_guarded(["analyse", *map(str, arguments)])
    said = capsys.readouterr()
    return code, said.out, said.err


def found_by(path, name=None, **options):
    request = AnalyseRequest(report=False, reconstruction=name, options=options)
    analysed = analyse_file(path, request)
    assert analysed.refused is None, analysed.refused
    return analysed


def read(path):
    return CbsrRecording().read(path, ReadOptions())


@pytest.mark.parametrize("name", rest_but_named({name: name for name in METHODS}, *FIRST))
def test_every_method_images_the_press_where_it_is(pressed, name):
    if name.startswith("pyeit"):
        pytest.importorskip("pyeit")
    analysed = found_by(pressed, name)
    document = json.loads(json.dumps(json_document(analysed), allow_nan=False))
    (event,) = document["events"]
    image = event["image"]
    away = np.hypot(image["x_over_R"] - PRESSED[0], image["y_over_R"] - PRESSED[1])
    assert away < COARSER.get(name, TOLERANCE)
    assert image["electrode"] == pytest.approx(np.arctan2(0.3, 0.4) * 16 / (2 * np.pi), abs=0.35)
    assert event["sign"] == -1
    assert image["largest_change"] < 0
    assert 0 < image["area_share"] < 0.2
    said = document["reconstruction"]
    assert (said["name"], said["options"]) == (name, {})
    assert said["parameter"]["name"]
    assert said["parameter"]["reason"]
    assert said["parameter"]["criterion"] in CRITERIA
    assert np.isfinite(said["parameter"]["value"])
    assert not any("does not show it" in warning for warning in document["warnings"])


def test_events_are_found_without_the_reconstruction(pressed):
    """Whatever images them, times, places and SNR are the same to the bit."""
    usual = json_document(found_by(pressed))["events"][0]
    other = json_document(found_by(pressed, "gauss-newton-laplace"))["events"][0]
    assert {k: v for k, v in usual.items() if k != "image"} == {k: v for k, v in other.items() if k != "image"}
    assert usual["image"] != other["image"]


@pytest.mark.rest
def test_the_usual_method_named_is_the_usual_method(pressed):
    usual, named = found_by(pressed).result, found_by(pressed, "gauss-newton-noser").result
    np.testing.assert_array_equal(usual.events[0].image.values, named.events[0].image.values)


class Watched:
    """A method that keeps what it is given; its images are those of another."""

    method, linear = "watched", False

    def __init__(self, sequences=False, absolute=False, images=None):
        self.sequences, self.absolute = sequences, absolute
        self.given, self._images = [], images

    def prepare(self, problem):
        self.problem = problem
        self._within = GaussNewtonNoser().prepare(problem)
        self.choice = replace(self._within.choice, criterion="")
        return self

    def images(self, changes):
        self.given.append(changes)
        images = self._within.images(changes)
        return images if self._images is None else self._images(images)


def test_only_events_are_imaged_and_each_is_told(two_at_once):
    watched, said = Watched(), []
    result = analyse_recording(read(two_at_once), watched, tell=said.append)
    assert len(result.events) == 2
    # Two changes, and their sum at the peak of the second: three images of 80 frames.
    assert [given.shape for given in watched.given] == [(1, 208)] * 3
    np.testing.assert_allclose(watched.given[2], watched.given[0] + watched.given[1], rtol=1e-12)
    assert [one.split(" with ")[0] for one in said[:2]] == ["imaging event 1 of 2", "imaging event 2 of 2"]
    assert sorted(event.fate for event in result.events) == ["", "apart"]


def test_progress_is_told_per_event_on_stderr(pressed, capsys):
    code, out, err = run(capsys, pressed, "--reconstruction", "temporal", "--no-report")
    assert code == 0
    assert "imaging event 1 of 1 with temporal" in err
    assert "imaging" not in out
    assert "Images by temporal, λ" in out
    assert "in its image" in out


def test_the_image_of_a_sum_is_not_the_sum_of_the_images_unless_the_method_says_so():
    class Squares:
        method, choice = "squares", None

        def __init__(self, problem, linear):
            self.problem, self.linear = problem, linear

        def images(self, changes):
            return changes**2

    problem = type("Problem", (), {"mesh": type("Mesh", (), {"elements": np.zeros((2, 3))})})
    place = Place(0.0, 0.0, 0, 1.0)
    one, other = (
        Sighting(0, 0, 0, place, 1.0, change, change[None], slice(0, 1), change, Goodness(1.0, 1.0, in_model=True))
        for change in (np.array([1.0, 2.0]), np.array([3.0, 5.0]))
    )
    for linear, together in ((False, [16, 49]), (True, [10, 29])):
        images = EventImages("squares", Squares(problem, linear), np.ones(2), False)
        np.testing.assert_array_equal(images.image_together([one, other, one]), together)


def test_a_method_of_sequences_is_handed_the_frames_around_an_event(pressed):
    watched = Watched(sequences=True)
    (event,) = analyse_recording(read(pressed), watched).events
    (frames,) = watched.given
    # Eight frames before the press, and the thirty of it.
    assert 36 <= len(frames) <= 40
    size = np.linalg.norm(frames, axis=1)
    assert size[:7].max() < 0.3 * size[10:].min()
    assert event.imaged is not None


@pytest.mark.rest
def test_frames_that_know_nothing_of_each_other_are_the_one_step_image(pressed):
    alone = found_by(pressed, "temporal", correlation_frames=0).result.events[0].image.values
    one_step = found_by(pressed, "gauss-newton-indenter").result.events[0].image.values
    np.testing.assert_allclose(alone, one_step, rtol=0, atol=1e-9 * np.abs(one_step).max())
    smoothed = found_by(pressed, "temporal", correlation_frames=20).result.events[0].image.values
    assert np.abs(smoothed - one_step).max() > 1e-4 * np.abs(one_step).max()


def test_still_images_are_no_sequence_and_that_is_said(tmp_path):
    path = tmp_path / "tank.mat"
    frames = [np.abs(pressed_frames(*PRESSED, contrast=c, n=1, start=0, end=1)) for c in (-0.3, 0.0)]
    scipy.io.savemat(path, {"vv": frames[0].reshape(1, 256).T, "vvRef": frames[1].reshape(1, 256).T})
    request = AnalyseRequest(report=False, dataset="vv", reference=(path, "vvRef"), reconstruction="temporal")
    document = json_document(analyse_file(path, request))
    (event,) = document["events"]
    assert (event["image"]["x_over_R"], event["image"]["y_over_R"]) == pytest.approx(PRESSED, abs=0.06)
    assert any("temporal needs consecutive frames; this recording has none" in w for w in document["warnings"])


def test_frames_are_cut_next_to_the_step_and_against_those_before():
    changes = np.arange(5000.0)[:, None]
    frames, held = frames_around(changes, slice(100, 108), slice(109, 4000))
    assert (frames[0, 0], frames[held][0, 0], len(frames)) == (100 - 103.5, 109 - 103.5, 9 + 256)
    frames, held = frames_around(changes, slice(300, 308), slice(0, 290))  # held from the beginning
    assert (held, frames[held][-1, 0], frames[-1, 0]) == (slice(0, 256), 289 - 303.5, 307 - 303.5)
    frames, held = frames_around(changes, slice(0, 8), slice(3000, 3008))  # it took that long to come
    assert (held, len(frames), frames[0, 0]) == (slice(0, 8), 8, 3000 - 3.5)
    frames, at = nearest_frames(changes, 5)
    assert (frames[at, 0], len(frames)) == (5, 262)


@pytest.mark.rest
def test_an_absolute_method_is_handed_the_unloaded_readings_in_the_scale_of_the_changes(tmp_path):
    """In volts, with a gain that nobody states; they are those before the press, not those of the whole recording."""
    frames = 3.7 * pressed_frames(*PRESSED, contrast=-0.3, start=20, end=75)
    path = exported(tmp_path, frames)
    watched = Watched(absolute=True)
    analyse_recording(read(path), watched)
    problem, (change,) = watched.problem, watched.given
    assert problem.measured == pytest.approx(problem.reference, rel=5e-3)
    used = problem.used
    loaded = np.median(frames, axis=0)[used] / 3.7  # the press takes most of the recording
    assert np.abs(loaded / problem.reference - 1).max() > 0.03
    press = frames[30:70].mean(axis=0) - frames[:15].mean(axis=0)
    scale = float(frames[:15].mean(axis=0)[used] @ problem.reference / (problem.reference @ problem.reference))
    assert scale == pytest.approx(3.7, rel=1e-2)
    np.testing.assert_allclose(change[0], press[used] / scale, atol=3e-2 * np.abs(change).max())
    assert "leaves" in json_document(found_by(path, "absolute-gauss-newton"))["reconstruction"]["parameter"]["reason"]


@pytest.mark.rest
def test_counts_have_no_absolute_readings_and_that_is_said(tmp_path):
    frames = np.round(1000 + 2e4 * pressed_frames(*PRESSED, contrast=-0.3)).astype(int)
    document = json_document(found_by(BoardFile().header().frames(frames).save(tmp_path), "absolute-gauss-newton"))
    (event,) = document["events"]
    assert (event["image"]["x_over_R"], event["image"]["y_over_R"]) == pytest.approx(PRESSED, abs=0.06)
    assert any("starts from the nominal sheet" in warning for warning in document["warnings"])
    assert "nominal sheet" in document["reconstruction"]["parameter"]["reason"]


def test_channels_of_unequal_gain_are_no_absolute_readings(tmp_path, capsys):
    gains = np.exp(np.random.default_rng(5).normal(0, 1.0, (16, 16)))
    gains = (gains + gains.T) / 2
    path = exported(tmp_path, gains * pressed_frames(*PRESSED, contrast=-0.1))
    assert json_document(found_by(path, "gauss-newton-laplace"))["events"][0]["image"] is not None
    code, out, _ = run(capsys, path, "--json", "--reconstruction", "absolute-gauss-newton")
    refused = json.loads(out)["refused"]
    assert code == 2
    assert "absolute-gauss-newton cannot be used" in refused["reason"]
    assert "single scale does not map these" in refused["reason"]
    assert "difference reconstruction" in refused["remedy"]
    assert not (tmp_path / "var").exists()


def test_a_criterion_looks_at_the_changes_of_the_recording(pressed):
    parameter = json_document(found_by(pressed, "gauss-newton-laplace", choose="gcv"))["reconstruction"]["parameter"]
    assert parameter["criterion"] == "gcv"
    assert "1 measured change" in parameter["reason"]
    given = json_document(found_by(pressed, "gauss-newton-laplace", hyperparameter=0.01))["reconstruction"]
    assert given["options"] == {"hyperparameter": 0.01}
    assert (given["parameter"]["criterion"], given["parameter"]["value"]) == ("given", 0.01)


def test_changes_that_settle_no_parameter_are_said_not_hidden(pressed):
    """A method that refuses the sample is prepared without it."""

    class Fussy(Watched):
        def prepare(self, problem):
            if problem.sample is not None:
                raise NumericsError("the changes are all noise")
            return super().prepare(problem)

    result = analyse_recording(read(pressed), Fussy(), AnalysisChoices(reconstruction=PluginChoice("fussy", {})))
    assert len(result.events) == 1
    said = "cannot choose the parameter of fussy from this recording: the changes are all noise"
    assert any(said in warning for warning in result.warnings)


@pytest.mark.parametrize(
    ("images", "error", "said"),
    [
        (lambda values: values * np.nan, NumericsError, "non-finite values"),
        (lambda values: values[:, :-1], NumericsError, "images of shape"),
        (lambda values: 1 / 0, PluginError, "ZeroDivisionError"),
    ],
)
def test_what_is_no_image_is_refused_by_name(pressed, images, error, said):
    choices = AnalysisChoices(reconstruction=PluginChoice("watched"))
    with pytest.raises(error, match=said) as raised:
        analyse_recording(read(pressed), Watched(images=images), choices)
    assert raised.value.reason.startswith("watched cannot image E1 (at ")
    assert raised.value.remedy


def test_an_image_that_does_not_show_its_event_is_named(pressed):
    document = json_document(found_by(pressed, "total-variation", hyperparameter=1.0))
    (event,) = document["events"]
    assert event["image"] is None
    (said,) = [warning for warning in document["warnings"] if "by total-variation does not show it" in warning]
    assert said.startswith(f"the image of E1 (at {event['peak_s']:.1f} s) by ")


class Blank:
    """Images in which nothing is."""

    def prepare(self, problem):
        count = len(problem.mesh.elements)
        matrix = np.zeros((count, len(problem.reference)))
        return LinearReconstruction("blank", problem, matrix, ParameterChoice(1.0, "as asked", 1.0))


def test_objects_of_a_still_image_are_named_without_a_time():
    frames = pressed_frames(0.4, 0.3, contrast=0.0, n=2, seed=2)
    here, there = (pressed_frames(*at, contrast=0.3, n=1, start=0, end=1) for at in ((0.5, 0.0), (-0.5, 0.1)))
    voltages = here + there - frames[:1]
    empty, held = (
        FrameBlock(np.zeros(1), v, np.zeros(v.shape, np.uint8), VoltageUnit.VOLT, 0.001)
        for v in (frames[:1], voltages)
    )
    recording = Recording(Path("m.txt"), "text", "", ScanKind.FULL, held, empty, True, False, "none")
    result = analyse_recording(recording, Blank())
    said = [warning for warning in result.warnings if "does not show it" in warning]
    assert [warning.split(" by ")[0] for warning in said] == ["the image of E1", "the image of E2"]


@pytest.mark.rest
def test_the_report_names_the_method_its_options_and_why(pressed, capsys):
    names = []
    for arguments in (
        (),
        ("--reconstruction", "greit"),
        ("--reconstruction", "greit", "--option", "noise_figure=0.7"),
    ):
        code, out, _ = run(capsys, pressed, "--json", *arguments)
        assert code == 0
        names.append(json.loads(out)["report"])
    assert len(set(names)) == 3
    usual, _, html = (Path(name).read_text(encoding="utf-8") for name in names)
    assert "gauss-newton-noser" in usual
    assert "as by default" in usual
    for said in ("How the images were made", "greit", "noise_figure = 0.7", "noise figure 0.70 (Adler et al. 2009)"):
        assert said in html
    assert "Where the images show the events" in html


def test_where_nothing_is_found_nothing_is_imaged(tmp_path, capsys):
    path = exported(tmp_path, pressed_frames(0, 0, contrast=0.0))
    code, out, _ = run(capsys, path, "--json", "--reconstruction", "absolute-gauss-newton")
    document = json.loads(out)
    assert (code, document["events"]) == (0, [])
    assert document["reconstruction"]["name"] == "absolute-gauss-newton"
    assert document["reconstruction"]["parameter"] is None
    assert "nothing was imaged" in Path(document["report"]).read_text(encoding="utf-8")
