"""Figures: safe, repeatable, and drawn from what they are given."""

import re
from functools import cache
from itertools import pairwise

import matplotlib as mpl
import numpy as np
import pytest
from hypothesis import given, strategies as st
from matplotlib.figure import Figure as Canvas
from recording_samples import sample_recording
from sensor_samples import SENSOR

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.geometry.outlines import Disc
from cbsr_qa.domain.imaging import Blob, Image
from cbsr_qa.domain.results.observation import RelaxationObservation, Trace
from cbsr_qa.domain.results.relaxation import FitStatus, RelaxationFit, SettlingTime
from cbsr_qa.domain.results.report import Figure
from cbsr_qa.eit.mesh.sheet import image_mesh
from cbsr_qa.report.draw.channels import ChannelMark, channel_map_figure
from cbsr_qa.report.draw.images import ImagePanel, Marker, image_figure
from cbsr_qa.report.draw.metrics import Held, average_over_holds
from cbsr_qa.report.draw.parameter import log_ticks
from cbsr_qa.report.draw.relaxation import SettledLoad, relaxation_figure, relaxation_value
from cbsr_qa.report.draw.sheet import Raster, rings
from cbsr_qa.report.draw.style import drawing, name_rows, spread_labels
from cbsr_qa.report.draw.time import Span, thin_trace, timeline_figure
from cbsr_qa.report.svg import check_svg
from cbsr_qa_plugins.sections.recording import RecordingEvents

SVG = '<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink">{}</svg>'


@pytest.fixture(scope="module")
def mesh():
    return image_mesh(SENSOR, size_mm=5.0)


def timeline(name="force", spans=()):
    time_s = np.linspace(0, 60, 50)
    trace = Trace(name, "N", time_s, np.sin(time_s / 9))
    return timeline_figure([trace], spans)


@pytest.mark.parametrize(
    "content",
    [
        "<script>alert(1)</script>",
        "<style>*{display:none}</style>",
        '<g onload="alert(1)"/>',
        '<g ONCLICK="alert(1)"/>',
        "<foreignObject><p>x</p></foreignObject>",
        '<a href="#x"><path d="M0 0"/></a>',
        '<image href="http://example.org/x.png"/>',
        '<image xlink:href="file:///etc/passwd"/>',
        '<image href="data:image/svg+xml;base64,AAAA"/>',
        '<use href="javascript:alert(1)"/>',
        '<use href="data:image/png;base64,AAAA"/>',
        '<rect style="fill:url(http://example.org/)"/>',
        '<rect fill="URL(  //example.org/x)"/>',
        '<set attributeName="href" to="javascript:alert(1)"/>',
        "<!-- --><g/>",
        "<![CDATA[<script>]]>",
        "<g>",
    ],
)
def test_an_svg_that_could_do_more_than_be_looked_at_is_refused(content):
    with pytest.raises(RefusedError):
        check_svg(SVG.format(content))


def test_entities_are_refused_before_they_are_expanded():
    with pytest.raises(RefusedError, match="declaration"):
        check_svg('<!DOCTYPE svg [<!ENTITY a "aaaa">]>' + SVG.format("<text>&a;</text>"))


def test_a_harmless_svg_passes_unchanged():
    harmless = SVG.format('<defs><path id="m" d="M0 0"/></defs><use href="#m"/><rect fill="url(#g)"/>')
    assert check_svg(harmless) == harmless


def test_the_same_numbers_give_the_same_bytes():
    assert timeline() == timeline()


def test_every_figure_passes_the_check_and_leaves_no_trace_in_the_settings(mesh):
    before = dict(mpl.rcParams)
    image = Image(mesh, mesh.centroids_mm[:, 0] / 500)
    values = np.arange(256.0).reshape(16, 16)
    marks = [ChannelMark(((0, 5),), "x", "saturated"), ChannelMark((), "o", "stuck")]
    figures = [
        timeline(spans=[Span(10, 20, "E1", 13)]),
        image_figure(
            [ImagePanel("a", image, (Marker(1, 2, "E1"),), "note")], sheet=Disc(50.0), electrodes=SENSOR.electrodes
        ),
        channel_map_figure(values, label="SNR", unit="dB", used=values > 3, marks=marks),
        channel_map_figure(np.full((1, 16), np.nan), label="SNR", unit="dB"),
    ]
    for figure in figures:
        check_svg(figure)
    assert dict(mpl.rcParams) == before


def test_figures_on_one_page_share_no_names():
    names = [set(re.findall(r' id="([^"]+)"', figure)) for figure in (timeline("a"), timeline("b"))]
    assert names[0]
    assert not names[0] & names[1]


def test_every_name_that_is_referred_to_is_there():
    svg = timeline(spans=[Span(1, 2, "E")])
    assert set(re.findall(r'(?:href="|url\()#([^")]+)', svg)) == set(re.findall(r' id="([^"]+)"', svg))


def test_text_in_a_figure_is_text_and_never_a_formula():
    svg = timeline('<script>"$x^2$" & مرحبا')
    check_svg(svg)
    assert "&lt;script&gt;" in svg
    assert "$x^2$" in svg
    assert "مرحبا" in svg


def test_units_of_the_recording_need_no_millimetres():
    result = sample_recording(1)
    event = result.events[0]
    panel = ImagePanel("E1", event.image, (Marker(event.x_over_R, event.y_over_R),))
    figure = image_figure([panel], sheet=Disc(1.0), electrodes=SENSOR.electrodes)
    words = re.findall(r"<text[^>]*>([^<]*)</text>", figure)
    assert "E1" in words
    assert not any("mm" in text for text in words)


def canvas_of(draw, *given):
    """The canvas that a figure is built on."""
    with drawing():
        canvas = draw.__wrapped__(*given)
        canvas.draw_without_rendering()
    return canvas


def left_of_numbers(canvas):
    """How far each vertical axis's label ends left of its widest number, and begins right of the edge [in]."""
    for axes in canvas.axes:
        label = axes.yaxis.label
        if label.get_text() and axes.yaxis.get_label_position() == "left":
            low, high = sorted(axes.get_ylim())
            numbers = [
                tick.label1.get_window_extent().x0
                for tick in axes.yaxis.get_major_ticks()
                if low <= tick.get_loc() <= high and tick.label1.get_text()
            ]
            box = label.get_window_extent()
            yield (min(numbers) - box.x1) / canvas.dpi, box.x0 / canvas.dpi


@pytest.mark.parametrize("level", [1.0, 2e-3, 40000.0, -70000.0])
def test_axis_labels_are_clear_of_numbers_however_wide_these_are(level):
    time_s = np.linspace(0, 60, 50)
    values = level * (1 + 0.01 * np.sin(time_s / 9))
    traces = [Trace("change", "V", time_s, values), Trace("force", "N", time_s, values)]
    fit = RelaxationFit(FitStatus.REJECTED, 0.0, (), (), 0.0, (), 0.0, "short")
    shown = Trace("image", "1", time_s, values)
    relaxation = RelaxationObservation("image", True, shown, fit, SettlingTime(None, False, 1.0, "short"))
    relaxed = SettledLoad("L1", "p", 0.2, (relaxation,))
    for canvas in (
        canvas_of(timeline_figure, traces, ()),
        canvas_of(relaxation_figure, [relaxed], relaxed, ["image"]),
    ):
        clear = list(left_of_numbers(canvas))
        assert clear
        for gap, edge in clear:
            assert gap > 0.01
            assert edge > 0.01


@pytest.mark.parametrize("shared_scale", [True, False])
def test_every_image_has_a_colour_scale_in_percent_its_own_or_a_common_one(shared_scale):
    """Values of two images a thousand times apart: ticks of one scale cannot say both."""
    image = sample_recording(1).events[0].image
    panels = [
        ImagePanel(name, Image(image.mesh, size * image.values / np.abs(image.values).max()))
        for name, size in (("E1", 0.002), ("E2", 2.0))
    ]
    figure = image_figure(panels, sheet=Disc(1.0), shared_scale=shared_scale)
    words = re.findall(r"<text[^>]*>([^<]*)</text>", figure)
    assert words.count("conductance change Δγ/γ₀ [%]") == (1 if shared_scale else 2)
    ticks = {abs(float(text.replace("−", "-"))) for text in words if re.fullmatch(r"−?[\d.]+", text)}
    assert max(ticks) in (100, 150, 200)
    assert any(0 < tick <= 0.2 for tick in ticks) is not shared_scale


@pytest.mark.parametrize(("events", "said"), [(1, False), (2, True)])
def test_the_caption_of_several_events_says_that_scales_differ(events, said):
    section = RecordingEvents().render(sample_recording(events))
    (pictures,) = [block for block in section.blocks if isinstance(block, Figure) and "Marked:" in block.caption]
    assert ("Each image has its own colour scale" in pictures.caption) is said
    assert pictures.svg.count("conductance change Δγ/γ₀ [%]") == events


@pytest.mark.rest
def test_the_way_of_an_object_is_drawn_from_a_ring_to_a_dot():
    image = sample_recording(1).events[0].image
    still = ImagePanel("E1", image)
    moved = ImagePanel("E1", image, track=np.array([[0.5, 0.0], [0.0, 0.5], [-0.5, 0.0]]))
    still_svg, moved_svg = (image_figure([panel], sheet=Disc(1.0)) for panel in (still, moved))
    assert moved_svg.count("<path") >= still_svg.count("<path") + 3
    assert moved_svg.count("<use") == still_svg.count("<use") + 2


@given(st.floats(-30, 30), st.floats(-30, 30), st.floats(4, 18), st.booleans())
def test_an_outline_encloses_its_elements_holes_left_out(x, y, radius, ring):
    mesh = image_mesh_once()
    far = np.hypot(*(mesh.centroids_mm - [x, y]).T)
    elements = np.flatnonzero((far < radius) & ((far > 0.6 * radius) | (not ring)))
    if not elements.size:
        return
    found = rings(Blob(Image(mesh, np.ones(len(mesh.elements))), elements))
    enclosed = sum(_signed_area(points) for points in found)
    assert enclosed == pytest.approx(mesh.areas_mm2[elements].sum())
    assert all((points[0] == points[-1]).all() for points in found)


def test_a_pixel_shows_the_element_it_lies_in(mesh):
    raster = Raster(mesh, Disc(50.0), 80)
    step = 100 / 80
    rows, columns = np.nonzero(raster.elements >= 0)
    points = -50 + step * (np.column_stack([columns, rows]) + 0.5)
    corners = mesh.corners_mm[raster.elements[rows, columns]]
    inside = np.ones(len(points), dtype=bool)
    for k in range(3):
        edge, to = corners[:, (k + 1) % 3] - corners[:, k], points - corners[:, k]
        inside &= edge[:, 0] * to[:, 1] - edge[:, 1] * to[:, 0] >= -1e-9
    rim = np.hypot(*points.T) > 48
    assert inside[~rim].all()
    assert (np.hypot(*points.T) <= 50).all()
    assert len(points) * step**2 == pytest.approx(np.pi * 50**2, rel=0.01)


def test_a_line_that_is_thinned_keeps_its_spike():
    time_s, values = np.arange(20000.0), np.zeros(20000)
    values[7777] = 5.0
    kept_s, kept = thin_trace(time_s, values, 400)
    assert len(kept) <= 400
    assert kept.max() == 5.0
    assert kept_s[kept.argmax()] == 7777
    assert (np.diff(kept_s) > 0).all()


def test_what_waiting_buys_is_an_average_over_the_presses():
    time_s = np.arange(0, 200.0, 2.5)
    held = [Held("a", 0, 50), Held("b", 100, 150)]
    values = np.where(time_s < 100, 1.0, 3.0)
    values[time_s == 105] = np.nan
    since, mean, low, high = average_over_holds(time_s, values, held)
    assert len(since) == 20
    assert since[2] == 5.0
    assert mean[3] == 2.0
    assert mean[2] == 1.0  # only one press was seen there
    assert (low <= mean).all()
    assert (mean <= high).all()


def test_nothing_seen_gives_an_empty_profile():
    since, *_ = average_over_holds(np.arange(10.0), np.full(10, np.nan), [Held("a", 0, 10)])
    assert not len(since)


def test_the_fit_is_drawn_as_it_is_defined():
    fit = RelaxationFit(FitStatus.TWO, 2.0, (1.0, -0.5), (3.0, 20.0), 0, (0, 0), 1.0, "")
    expected = 2 + np.exp(-6 / 3) - 0.5 * np.exp(-6 / 20)
    assert relaxation_value(fit, np.array([6.0]))[0] == pytest.approx(expected)


@given(st.lists(st.floats(0, 100), max_size=12))
def test_labels_are_spread_without_overlap_and_in_order(places):
    moved = spread_labels(places, 3.0)
    order = sorted(range(len(places)), key=lambda k: places[k])
    ranked = [moved[k] for k in order]
    assert all(b - a > 3.0 * 0.97 for a, b in pairwise(ranked))


@cache
def image_mesh_once():
    return image_mesh(SENSOR, size_mm=5.0)


def _signed_area(ring):
    x, y = ring.T
    return float((x[:-1] * y[1:] - x[1:] * y[:-1]).sum() / 2)


@pytest.mark.parametrize(("count", "named"), [(1, 1), (34, 34), (35, 18), (100, 34), (222, 32)])
def test_rows_are_named_as_closely_as_they_can_be_read(count, named):
    axes = Canvas().add_subplot()
    name_rows(axes, [f"L{k}" for k in range(count)])
    found = [(tick, label.get_text()) for tick, label in zip(axes.get_yticks(), axes.get_yticklabels(), strict=True)]
    assert len(found) == named
    assert all(label == f"L{tick}" for tick, label in found)
    assert axes.get_ylim() == (count - 0.4, -0.6)


@pytest.mark.parametrize(
    ("low", "high"), [(0.9, 1.2), (0.19, 1.1), (0.04, 0.4), (3e-4, 2e-2), (1e-7, 1e3), (0.3, 1400)]
)
def test_every_scale_has_some_ticks_and_not_too_many(low, high):
    ticks = log_ticks(low, high)
    assert 1 <= len(ticks) <= 9
    assert len(ticks) >= 3 or high < 2 * low
    assert ticks == sorted(set(ticks))
    assert low <= ticks[0] <= ticks[-1] <= high
