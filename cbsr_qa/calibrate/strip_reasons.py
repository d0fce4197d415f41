"""Why a characterisation cannot stand for its material, or stands for less of it."""

from collections.abc import Sequence

from cbsr_qa.domain.characterisation import Characterisation


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
    return tuple(dict.fromkeys(said))


def why_reduced(found: Characterisation, why_no_stress: Sequence[str]) -> tuple[str, ...]:
    """Everything that was left out, or narrows the range of use."""
    said = [f"left out: {level.why}" for level in found.levels if level.why]
    said += why_no_stress
    kept = [level.strain for level in found.levels if not level.why]
    if found.lowest_strain is not None and found.lowest_strain > min(kept):
        said.append(
            f"α ε + β is clear of zero from {100 * found.lowest_strain:g} % strain on: below, it says nothing"
        )
    return tuple(said)
