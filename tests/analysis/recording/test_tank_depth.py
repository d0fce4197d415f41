import numpy as np
import pytest
import scipy.io
from tiers import rest_but

from cbsr_qa.analysis.recording.imaging import nominal_disc, sheet_for
from cbsr_qa.analysis.recording.places import matcher
from cbsr_qa.analysis.recording.tank import find_still, fit_tank
from cbsr_qa.eit.loads.bodies import DeepTank

DISC = nominal_disc(None, 16)
USED = DISC.pattern.usable()
SHEET = sheet_for(DISC, USED)
ANGLES = DISC.electrodes.angles_rad()


@pytest.mark.parametrize("depth", [0.8, 1.5, 2.5])
def test_the_depth_is_told_from_the_reference(depth):
    reference = DeepTank(depth, ANGLES, DISC.pattern, electrode=0.08).readings()[USED]
    random = np.random.default_rng(2)
    noisy = -3.7 * reference * (1 + 0.02 * random.standard_normal(len(reference)))
    tank = fit_tank(np.abs(noisy), SHEET.problem)
    assert tank.depth == pytest.approx(depth, rel=0.05)


def test_sheets_and_channels_of_unequal_gain_are_no_tanks():
    assert fit_tank(SHEET.problem.reference, SHEET.problem) is None
    deep = DeepTank(1.5, ANGLES, DISC.pattern).readings()[USED]
    drive, measure = np.nonzero(USED)
    apart = np.minimum((measure - drive) % 16, (drive - measure) % 16)
    assert fit_tank(deep * np.where(apart % 2, 1.0, 3.0), SHEET.problem) is None
    drive, measure = np.indices(USED.shape)
    near = USED & (np.minimum((measure - drive) % 16, (drive - measure) % 16) <= 4)
    assert fit_tank(DeepTank(1.5, ANGLES, DISC.pattern).readings()[near], sheet_for(DISC, near).problem) is None


@pytest.mark.parametrize("conducts", [False, True])
def test_a_ball_is_found_where_it_is_and_as_large(conducts):
    true = DeepTank(1.9, ANGLES, DISC.pattern)
    place, radius = np.array([0.15, 0.54]), 0.15
    volume = 4 / 3 * np.pi * radius**3
    relative = volume * (true.changes(place[None], radius, conducts=conducts)[0] / true.readings())[USED]
    change = relative * SHEET.problem.reference
    tank = fit_tank(true.readings()[USED], SHEET.problem)
    places = {}
    ball, seen = 0.1, conducts
    for name in ("sheet", "first", "second", "third"):
        sheet = SHEET if name == "sheet" else tank.sheet(SHEET, ball=ball, conducts=seen)
        match = matcher(sheet.patterns, sheet.places, np.full(len(change), 1e-3), SHEET.problem.reference)
        found, _ = find_still(match.whiten(change[None])[0], match)
        places[name] = np.array([found[0].place.x, found[0].place.y])
        if name != "sheet":
            ball, seen = tank.ball_of(found, sheet, change)
    assert np.hypot(*(places["third"] - place)) < 0.01
    assert np.hypot(*places["sheet"]) > np.hypot(*place) + 0.015  # a sheet's patterns put it further out
    assert ball == pytest.approx(radius, abs=0.01)
    assert seen is conducts


@pytest.mark.shared
@pytest.mark.parametrize(("dataset", "balls"), rest_but({"vvAvg3"}, [("vvAvg1", 1), ("vvAvg2", 1), ("vvAvg3", 2)]))
def test_depth_and_ball_of_a_real_tank_agree_on_its_radius(shared, dataset, balls):
    """26 cm of water (the data's authors) over the depth in radii, and 2.13 cm (a golf ball, R&A) over its size."""
    frames = scipy.io.loadmat(shared / "data/tank/phantom_16elec_1planeB.mat")
    reference, change = (frames[name].reshape(16, 16)[USED] for name in ("vvRef", dataset))
    tank = fit_tank(reference, SHEET.problem)
    ball = 0.1
    for _ in range(3):
        sheet = tank.sheet(SHEET, ball=ball, conducts=False)
        relative = (change - reference) / reference * SHEET.problem.reference
        match = matcher(sheet.patterns, sheet.places, np.full(len(relative), 1e-4), SHEET.problem.reference)
        found, _ = find_still(match.whiten(relative[None])[0], match)
        ball, conducts = tank.ball_of(found, sheet, relative)
    assert len(found) == balls
    assert not conducts
    assert 2.13 / ball == pytest.approx(26 / tank.depth, rel=0.08)
    assert all(
        abs(np.hypot(one.place.x, one.place.y) * 26 / tank.depth - 7 * (dataset != "vvAvg1")) < 0.75 for one in found
    )
