"""A material from press cycles: its parameters against the truth, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest
from strip_samples import SPEED, Truth, readings, specimen

from cbsr_qa.calibration.fits.quasi_static import fit_quasi_static
from cbsr_qa.calibration.strip.characterisation import characterise
from cbsr_qa.calibration.strip.lines import (
    decide_response,
    fit_line,
    fit_modulus,
    lowest_clear_strain,
    strain_levels,
)
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.plan.analysis_settings import CharacterisationSettings
from cbsr_qa.domain.results.characterisation import CycleChange
from cbsr_qa.domain.sensor.sensor_type import Parameter, QuasiStatic, Response

SETTINGS = CharacterisationSettings()


def characterised(truth, **options):
    declared = options.pop("declared", Response.AUTO)
    return characterise(readings(truth, **options), specimen(declared), SETTINGS)


def measured_error(line):
    """Standard error of a slope without what is assumed of the contacts, which is right here."""
    return float(np.sqrt(sum(error**2 for part, error in line.parts if part != "contacts of the pins")))


@pytest.fixture(scope="module")
def found():
    return characterised(Truth(residue=0.02), count=6, seed=3)


@pytest.mark.rest
def test_the_gauge_factor_under_the_head_is_the_materials(found):
    line = found.local_against_strain
    assert line.line.slope.value == pytest.approx(0.6, rel=0.03)
    assert abs(line.line.slope.value - 0.6) < 3 * measured_error(line)
    assert abs(line.line.intercept.value) < 3 * line.line.intercept.stderr
    assert found.local_against_stress.line.slope.value == pytest.approx(0.6 / 132.5, rel=0.03)
    assert found.response is Response.INCREASE
    assert (found.refused, found.reduced) == ((), ())


def test_between_the_pins_it_is_the_heads_share_of_that(found):
    """Between the chord at small changes and that at the largest, which is flatter: resistances in series."""
    share = found.against_strain.line.slope.value / found.local_against_strain.line.slope.value
    assert 0.8 * found.strip.head_share < share < found.strip.head_share


def test_contacts_are_the_larger_part_of_the_error(found):
    parts = dict(found.local_against_strain.parts)
    assert set(parts) == {"scatter of the cycles", "time constants", "slow residue", "contacts of the pins"}
    assert "contacts of the pins" not in dict(found.against_strain.parts)
    # Contacts half as large again are 3.6 % of the resistance more, nothing of which is under the head.
    assert parts["contacts of the pins"] / 0.6 == pytest.approx(0.5 * found.strip.contact_share, rel=0.35)
    total = np.sqrt(sum(error**2 for error in parts.values()))
    assert found.local_against_strain.line.slope.stderr == pytest.approx(total, rel=1e-6)


def test_the_modulus_and_the_missed_surface(found):
    assert found.modulus_kPa.value == pytest.approx(132.5, rel=1e-3)
    assert abs(found.modulus_kPa.value - 132.5) < 4 * found.modulus_kPa.stderr
    assert abs(found.strain_offset.value) < 1e-4


def test_kernels_of_a_unit_step_are_the_materials(found):
    material = Truth().material
    for kernel, true in (
        (found.loading, material.loading_relaxation),
        (found.unloading, material.unloading_relaxation),
        (found.stress, material.stress_relaxation),
    ):
        assert kernel.weights[1] == pytest.approx(true.weights[1], rel=0.06)
        assert kernel.time_constants_s[1] == pytest.approx(true.time_constants_s[1], rel=0.06)
        assert kernel.weights[0] == pytest.approx(true.weights[0], rel=0.3)
    assert found.stress.weights == pytest.approx(material.stress_relaxation.weights, rel=0.02)


def settled_s(kernel, ramp_s, tolerance=0.15):
    """When what a ramp leaves of a kernel is for the last time outside the band; by looking every millisecond."""
    time_s = np.arange(0.0, 100.0, 1e-3)
    left = np.zeros_like(time_s)
    for weight, tau in zip(kernel.weights, kernel.time_constants_s, strict=True):
        left += weight * tau / ramp_s * -np.expm1(-ramp_s / tau) * np.exp(-time_s / tau)
    outside = np.flatnonzero(np.abs(left) > tolerance)
    return float(time_s[outside[-1]]) if outside.size else 0.0


@pytest.mark.parametrize("strain", [0.1, 0.2, 0.3])
def test_settling_times_by_strain_are_right_within_five_percent_or_their_own_error(found, strain):
    material = Truth().material
    for signal, loading, kernel in (
        ("conductance", True, material.loading_relaxation),
        ("conductance", False, material.unloading_relaxation),
        ("stress", True, material.stress_relaxation),
    ):
        one = next(o for o in found.settlings if (o.signal, o.loading, o.strain) == (signal, loading, strain))
        true = settled_s(kernel, strain / SPEED)
        assert abs(one.settling.value_s - true) < max(0.05 * true, 3 * one.stderr_s), (signal, loading)
        assert one.traces == 6


def test_a_residue_that_outlasts_the_relaxation_is_told(found):
    share, decay_s = found.residue
    assert abs(share.value - 0.02) < 3 * share.stderr
    assert abs(decay_s.value - 600) < 3 * decay_s.stderr


@pytest.mark.rest
def test_errors_are_honest_over_seeds():
    """Pulls of slope and modulus: size and mean as a standard normal's, to what six of them tell.

    Over forty seeds of twelve cycles the slope's have a deviation of 1.0; over twelve of sixty cycles one of 0.6.
    """
    pulls = []
    for seed in range(100, 106):
        one = characterised(Truth(), strains=(0.15, 0.3), count=2, seed=seed)
        line, modulus = one.local_against_strain, one.modulus_kPa
        pulls.append([(line.line.slope.value - 0.6) / measured_error(line), (modulus.value - 132.5) / modulus.stderr])
    size = np.sqrt((np.array(pulls) ** 2).mean(axis=0))
    assert ((size > 0.3) & (size < 1.7)).all(), size
    assert (np.abs(np.mean(pulls, axis=0)) < 1.1).all()


@pytest.mark.rest
def test_a_weak_strain_is_left_out_with_its_numbers():
    truth = Truth(replace(Truth().material, against_strain=Truth().with_line(0.2).material.against_strain))
    one = characterised(truth, strains=(0.005, 0.1, 0.2), count=4, noise=5e-3, seed=4)
    weak, *others = one.levels
    assert weak.why.startswith("0.5 % strain: the deviation over 4 cycles, ")
    assert "exceeds the mean change of" in weak.why
    assert not any(level.why for level in others)
    assert f"left out: {weak.why}" in one.reduced
    assert one.local_against_strain.line is not None


@pytest.mark.rest
def test_a_material_that_conducts_less_is_characterised_alike():
    one = characterised(Truth().with_line(-0.6), count=3, seed=2, declared=Response.INCREASE)
    assert one.response is Response.DECREASE
    assert one.local_against_strain.line.slope.value == pytest.approx(-0.6, rel=0.03)
    assert one.refused == ("the cycles say decrease, the sensor type says increase",)


def test_one_strain_has_no_line():
    one = characterised(Truth(), strains=(0.2,), count=4)
    assert one.local_against_strain.line is None
    assert "slope and intercept need two" in one.local_against_strain.why
    assert any("no line against strain" in why for why in one.refused)
    assert one.settlings  # what one strain tells is told


@pytest.mark.rest
def test_without_force_there_is_no_material():
    silent = [
        replace(one, stress_s=np.zeros(0), stress_kPa=np.zeros(0), stress_why="the load cell is flat at its limit")
        for one in readings(Truth(), count=3)
    ]
    one = characterise(silent, specimen(), SETTINGS)
    assert (one.modulus_kPa, one.stress) == (None, None)
    assert "the load cell is flat at its limit" in one.reduced
    assert any(why.startswith("no modulus") for why in one.refused)
    assert one.local_against_strain.line.slope.value == pytest.approx(0.6, rel=0.04)


def test_no_cycles_are_refused():
    with pytest.raises(NumericsError, match="no press cycle can be used"):
        characterise([], specimen(), SETTINGS)


# --- lines by themselves ---


def cycle(strain, change, *, stress=None, number=0, stderr=1e-4):
    return CycleChange(0, strain, number, change, stderr, change, stderr, change, change, stress, 0.01)


def test_strains_that_disagree_in_sign_are_refused_by_name():
    rising = [cycle(0.1, 0.010 + 1e-4 * k, number=k) for k in range(3)]
    falling = [cycle(0.2, -0.020 + 1e-4 * k, number=k) for k in range(3)]
    response, why = decide_response(strain_levels([*rising, *falling]), Response.AUTO)
    assert response is Response.AUTO
    assert why.startswith("strains disagree in sign: 10 % changes the conductance by +0.01, 20 % by -0.02")
    assert decide_response((), Response.AUTO) == (Response.AUTO, "no strain changes the conductance clearly")


def test_a_strain_of_which_a_cycle_goes_the_other_way_is_left_out():
    cycles = [cycle(0.2, 0.02, number=k) for k in range(9)]
    (level,) = strain_levels([*cycles, cycle(0.2, -0.02, number=9)])
    assert "1 of 10 cycles change the other way (cycle 10 by -0.02" in level.why
    (level,) = strain_levels(cycles)
    assert not level.why


def test_the_least_strain_that_says_something():
    line = QuasiStatic(Parameter(0.6, 0.01, ""), Parameter(-0.06, 0.002, ""), 0.0)
    assert lowest_clear_strain(line, [0.05, 0.1, 0.15, 0.2]) == 0.05  # -0.03, clearly the other way
    assert lowest_clear_strain(line, [0.1, 0.15, 0.2]) == 0.15  # nothing at 10 %
    assert lowest_clear_strain(line, [0.1]) is None
    assert lowest_clear_strain(None, [0.1]) is None


def test_what_is_not_in_the_scatter_widens_the_covariance():
    cycles = [cycle(strain, 0.6 * strain, number=k) for strain in (0.1, 0.2, 0.3) for k in range(3)]
    changes, errors = [c.apparent for c in cycles], [c.apparent_stderr for c in cycles]
    moved = {"contacts": [[1.05 * change for change in changes]]}
    plain = fit_line(cycles, changes, errors, lambda c: c.strain, {}, "test").line
    wider = fit_line(cycles, changes, errors, lambda c: c.strain, moved, "test")
    assert wider.line.slope.value == plain.slope.value
    assert wider.line.slope.stderr == pytest.approx(np.hypot(plain.slope.stderr, 0.05 * 0.6), rel=1e-6)
    assert dict(wider.parts)["contacts"] == pytest.approx(0.03, rel=1e-9)


def test_a_stress_that_does_not_rise_has_no_modulus():
    flat = [cycle(s, 0.6 * s, stress=5.0 + 0.1 * (k % 2), number=k) for s in (0.1, 0.2) for k in range(4)]
    modulus, offset, why = fit_modulus(flat, "test")
    assert (modulus, offset) == (None, None)
    assert why.startswith("the stress does not rise clearly with the strain")


#: NIST StRD, linear regression, "Norris" (ozone monitors): x, y.
NORRIS = np.array(
    [
        (0.2, 0.1), (337.4, 338.8), (118.2, 118.1), (884.6, 888.0), (10.1, 9.2), (226.5, 228.1),
        (666.3, 668.5), (996.3, 998.5), (448.6, 449.1), (777.0, 778.9), (558.2, 559.2), (0.4, 0.3),
        (0.6, 0.1), (775.5, 778.1), (666.9, 668.8), (338.0, 339.3), (447.5, 448.9), (11.6, 10.8),
        (556.0, 557.7), (228.1, 228.3), (995.8, 998.0), (887.6, 888.8), (120.2, 119.6), (0.3, 0.3),
        (0.3, 0.6), (556.8, 557.6), (339.1, 339.3), (887.2, 888.0), (999.0, 998.5), (779.0, 778.9),
        (11.1, 10.2), (118.3, 117.6), (229.2, 228.9), (669.1, 668.4), (448.9, 449.2), (0.5, 0.2),
    ]
)  # fmt: skip


def test_the_line_reproduces_the_certified_values_of_norris():
    """Certified by NIST: 1.00211681802045 ± 0.429796848199937e-3, −0.262323073774029 ± 0.232818234301152."""
    x, y = NORRIS.T
    assert len(x) == 36
    fit = fit_quasi_static(np.arange(1.0, 37.0), x, y)  # each its own level: all weigh the same
    assert fit.slope == pytest.approx(1.00211681802045, rel=1e-12)
    assert fit.intercept == pytest.approx(-0.262323073774029, rel=1e-10)
    assert np.sqrt(np.diag(fit.covariance)) == pytest.approx([0.429796848199937e-3, 0.232818234301152], rel=1e-9)
