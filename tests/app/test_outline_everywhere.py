"""Where a sheet ends is known to what stores it, what moves over it, and what draws it."""

import json
from dataclasses import replace

import numpy as np
import pytest
from calibration_samples import assert_same, sample_calibration, sample_force, sample_reconstruction
from matplotlib.figure import Figure
from simulated_setting import HEAD, context, scene

from cbsr_qa.analysis.recording.imaging import nominal_disc
from cbsr_qa.analysis.recording_files import read_recording, write_recording
from cbsr_qa.calibration.file.entries import decode, encode
from cbsr_qa.domain.errors import InstrumentError, RefusedError
from cbsr_qa.domain.geometry.outlines import Disc, Polygon
from cbsr_qa.domain.plan.world import SheetDesign
from cbsr_qa.domain.readings.frames import FrameBlock, Recording, ScanKind, VoltageUnit
from cbsr_qa.domain.sensor.electrodes import ElectrodeKind, PlacedElectrodes
from cbsr_qa.domain.sensor.patterns import adjacent_pattern
from cbsr_qa.domain.sensor.sensor_type import SensorType, polygon_sensor
from cbsr_qa.eit.mesh.files import mesh_sensor
from cbsr_qa.eit.mesh.sheet import image_mesh, sheet_mesh
from cbsr_qa.report.draw.sheet import Raster, draw_electrodes, draw_sheet, fit_sheet, sheet_path
from cbsr_qa.simulate.sheet import SimulatedSheet
from cbsr_qa.station.limits import place_violations
from cbsr_qa.store.runs.codec import decode_sensor_type, encode_setting
from cbsr_qa.testing.bench import example_plan
from cbsr_qa_plugins.hardware.simulated_bench import open_bench

ELBOW = ((-30.0, -30.0), (50.0, -30.0), (50.0, 0.0), (0.0, 0.0), (0.0, 50.0), (-30.0, 50.0))
STRIPS = ((0.0, -30.0), (40.0, -30.0), (50.0, -15.0), (20.0, 0.0), (0.0, 30.0), (-15.0, 50.0), (-30.0, 10.0))


def elbow(radius_mm=0.0):
    electrodes = PlacedElectrodes(ElectrodeKind.ARC, STRIPS, 6.0)
    return polygon_sensor("elbow", Polygon(ELBOW, radius_mm), 4.0, electrodes, adjacent_pattern(7))


def elbow_on_a_mesh():
    sensor = elbow()
    return mesh_sensor("meshed", sheet_mesh(sensor, size_mm=6.0), sensor.pattern, thickness_mm=4.0)


@pytest.mark.parametrize("make", [elbow, lambda: elbow(3.0), elbow_on_a_mesh], ids=["sharp", "rounded", "mesh"])
def test_a_stored_sensor_type_comes_back_as_it_was(make):
    sensor = make()
    stored = json.loads(json.dumps(encode_setting(sensor, HEAD)))
    assert decode_sensor_type(stored) == sensor


def test_a_stored_disc_holds_what_it_always_held():
    stored = encode_setting(example_plan().sensor_type, HEAD)["sensor_type"]
    assert set(stored) == {"name", "radius_mm", "thickness_mm", "electrodes", "pattern", "response"}


@pytest.mark.parametrize("make", [elbow, lambda: elbow(3.0), elbow_on_a_mesh], ids=["sharp", "rounded", "mesh"])
def test_a_calibration_file_holds_the_outline(make):
    sensor = make()
    calibration = replace(sample_calibration(), sensor_type=sensor, reconstruction=sample_reconstruction(sensor))
    force = sample_force(int(sensor.pattern.usable().sum()))
    calibration = replace(calibration, reference=np.ones(sensor.pattern.shape), force=force)
    back = decode(encode(calibration))
    assert back.sensor_type == sensor
    assert back.reconstruction.problem.sensor_type == sensor
    assert_same(back.sensor_type.polygon, sensor.polygon, "polygon")


def test_a_sensor_type_that_contradicts_itself_is_refused():
    sensor = elbow()
    with pytest.raises(RefusedError, match="7 electrodes, its pattern 8"):
        replace(sensor, pattern=adjacent_pattern(8))
    with pytest.raises(RefusedError, match="the disc of equal area has"):
        replace(sensor, radius_mm=50.0)


def test_a_recording_keeps_where_electrodes_were_placed(tmp_path):
    sensor = elbow()
    frames = FrameBlock(np.arange(2.0), np.ones((2, 7, 7)), np.zeros((2, 7, 7), np.uint8), VoltageUnit.VOLT, 1e-3)
    recording = Recording(
        tmp_path / "r.h5", "cbsr-recording", "", ScanKind.FULL, frames, None, False, False, "computer"
    )
    write_recording(tmp_path / "r.h5", replace(recording, layout=sensor.electrodes, sensor_type="elbow"))
    back = read_recording(tmp_path / "r.h5")
    assert back.layout == sensor.electrodes
    assert isinstance(nominal_disc(back.layout, 7), SensorType)  # where nobody has the sensor type's file


@pytest.mark.parametrize(
    ("place", "said"),
    [
        ((20.0, 10.0), "10 mm outside the sheet"),
        ((20.0, -5.0), "5 mm from the sheet's edge"),
        ((-15.0, -15.0), None),
        ((-4.0, -4.0), "5.657 mm from the sheet's edge"),  # from the inner corner
    ],
)
def test_the_dry_run_refuses_a_head_that_does_not_lie_on_the_sheet(place, said):
    plan = replace(example_plan(), sensor_type=elbow())
    found = [violation.what for violation in place_violations(*place, plan)]
    if said is None:
        assert found == []
    else:
        assert len(found) == 1
        assert said in found[0]
        assert "it needs 6.5 mm inside it" in found[0]


def test_the_simulated_head_does_not_travel_off_the_sheet():
    bench = open_bench(replace(context(scene()), sensor_type=elbow()))
    with pytest.raises(InstrumentError, match="outside the sheet") as caught:
        bench.move_to(25.0, 25.0)  # within the disc of equal area, in the elbow's notch
    assert "polygon of 6 corners, x from -30 to 50 mm, y from -30 to 50 mm" in str(caught.value)
    bench.move_to(40.0, -15.0)


def test_a_simulated_head_in_the_notch_presses_nothing():
    sheet = SimulatedSheet(SheetDesign.make_uniform(elbow(), HEAD), size_mm=6.0, interelectrode_resistance_ohm=1e4)
    with pytest.raises(RefusedError, match="is outside the sheet"):
        sheet.voltages({(25.0, 25.0): 0.1})
    pressed = sheet.voltages({(20.0, -15.0): 0.1})
    assert np.abs(pressed - sheet.unloaded).max() > 1e-3 * np.abs(sheet.unloaded).max()


def test_the_sheet_is_drawn_as_it_is():
    sensor = elbow(4.0)
    axes = Figure().add_subplot()
    draw_sheet(axes, sensor.outline, (100.0, 0.0))
    draw_electrodes(axes, sensor.electrodes, sensor.outline)
    fit_sheet(axes, sensor.outline)
    (edge,) = axes.patches
    corners = edge.get_xy()[:-1] - [100.0, 0.0]
    assert np.abs(sensor.outline.clearance_mm(corners)).max() < 1e-9
    assert len(corners) > 6 * 4
    strips = axes.collections[0].get_segments()
    for strip, place in zip(strips, STRIPS, strict=True):
        assert np.hypot(*(strip.mean(axis=0) - place)) < 1e-9
        assert np.hypot(*np.diff(strip, axis=0).T).sum() == pytest.approx(6.0)
    numbers = {text.get_text(): text.get_position() for text in axes.texts}
    assert set(numbers) == {str(number) for number in range(7)}
    assert (sensor.outline.clearance_mm(np.array(list(numbers.values()))) < 0).all()
    assert axes.get_xlim() == pytest.approx((-30 - 0.16 * 40, 50 + 0.16 * 40))


def test_a_drawn_disc_is_a_circle():
    axes = Figure().add_subplot()
    draw_sheet(axes, Disc(50.0))
    fit_sheet(axes, Disc(50.0))
    (edge,) = axes.patches
    assert edge.get_radius() == 50.0
    assert axes.get_ylim() == pytest.approx((-58.0, 58.0))
    assert np.hypot(*sheet_path(Disc(50.0)).T) == pytest.approx(50.0)


def test_a_picture_of_an_image_ends_where_the_sheet_does():
    sensor = elbow(4.0)
    mesh = image_mesh(sensor, size_mm=5.0)
    raster = Raster(mesh, sensor.outline, 80)
    picture = raster.picture(mesh.centroids_mm[:, 0])
    assert raster.extent == pytest.approx((-30.0, 50.0, -30.0, 50.0))
    y, x = np.mgrid[-29.5:50:1.0, -29.5:50:1.0]
    clear = sensor.outline.clearance_mm(np.column_stack([x.ravel(), y.ravel()])).reshape(x.shape)
    apart = np.abs(clear) > 0.5  # a chord may stand out of a corner that is rounded inwards
    np.testing.assert_array_equal(picture.mask[apart], (clear < 0)[apart])
    assert not picture.mask[clear >= 0].any()
    assert np.abs(picture - x).max() < 5.0
