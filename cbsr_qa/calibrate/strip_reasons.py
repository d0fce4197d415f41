"""Why a characterisation cannot stand for its material, or stands for less of it."""

from collections.abc import Iterator, Sequence
from typing import Final

from cbsr_qa.domain.characterisation import Characterisation

#: Data are taken at this many settling times or later (science, section 8).
_MULTIPLE: Final = 1.5
#: More of a release than this that outlasts its rest is no residue: the rests are too short to tell.
_MOST_RESIDUE: Final = 0.1


def why_refused(found: Characterisation, disagreement: str, why_no_modulus: str) -> tuple[str, ...]:
    """Every reason why this cannot stand for the material."""
    said = [disagreement] if disagreement else []
    for name, line in (("strain", found.local_against_strain), ("stress", found.local_against_stress)):
        if line.line is None:
            said.append(f"no line against {name}: {line.why}")
    if found.local_against_strain.line is not None and found.lowest_strain is None:
        said.append("α ε + β is not clear of zero at any strain")
    if found.modulus_kPa is None:
        said.append(f"no modulus: {why_no_modulus}")
    for name, kernel in (("loading", found.loading), ("unloading", found.unloading), ("stress", found.stress)):
        if kernel is None:
            why = next((s.fit.why for s in found.settlings if s.strain is None and name in s.words), "not recorded")
            said.append(f"no relaxation of {name}: {why}")
    if found.residue is not None and found.residue[0].value > _MOST_RESIDUE:
        said.append(
            f"{100 * found.residue[0].value:.2g} % of every release outlasts its rest: holds and rests are too short"
            " for steady levels"
        )
    return tuple(dict.fromkeys(said))


def why_reduced(found: Characterisation, why_no_stress: Sequence[str]) -> tuple[str, ...]:
    """Everything that was left out, or narrows the range of use."""
    said = [f"left out: {level.why}" for level in found.levels if level.why]
    said += why_no_stress
    said += _short(found)
    kept = [level.strain for level in found.levels if not level.why]
    if found.lowest_strain is not None and found.lowest_strain > min(kept):
        said.append(
            f"α ε + β is clear of zero from {100 * found.lowest_strain:g} % strain on: below, it says nothing"
        )
    return tuple(said)


def _short(found: Characterisation) -> Iterator[str]:
    """Holds and rests that end before levels are settled: these are then extrapolated by the fits."""
    for one in found.settlings:
        if one.strain is not None or one.settling.value_s is None or not len(one.time_s):
            continue
        window_s, needed_s = float(one.time_s[-1]), _MULTIPLE * one.settling.value_s
        if needed_s > window_s or one.settling.censored:
            least = "at least " if one.settling.censored else ""
            yield (
                f"{'holds' if one.loading else 'rests'} of {window_s:.3g} s are shorter than {_MULTIPLE:g} settling"
                f" times of {one.signal} ({least}{one.settling.value_s:.3g} s): steady levels are extrapolated"
            )
