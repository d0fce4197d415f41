"""How the loads of a batch relax: one kernel for the longest holds of all its runs, whatever sensor they are of.

Sensors of a batch are of one material. That they relax differently is in the scatter between loads of the kernel.
"""

from collections.abc import Sequence

from cbsr_qa.analysis.run.compensation import LONG
from cbsr_qa.analysis.run.force_kernels import Transients
from cbsr_qa.analysis.run.long_holds import LongHolds
from cbsr_qa.calibration.batch.kept import keep_kernel
from cbsr_qa.domain.plan.batch_model import KeptRelaxation


def learn_relaxation(runs: Sequence[LongHolds]) -> KeptRelaxation | None:
    """Learn the kernels of a batch; None if the longest holds of its runs do not determine them."""
    if not runs:
        return None
    longest_s = max(run.hold_s for run in runs)
    of_longest = [run for run in runs if run.hold_s >= LONG * longest_s]
    rises, decays, forces = (
        Transients.join([part for part in parts if part is not None]) if any(parts) else None
        for parts in (
            [run.rises for run in of_longest],
            [run.decays for run in of_longest],
            [run.forces for run in of_longest],
        )
    )
    strength, unloading, stress = (
        None if transients is None else transients.learn_usable() for transients in (rises, decays, forces)
    )
    if strength is None or stress is None:
        return None
    return KeptRelaxation(
        hold_s=min(run.hold_s for run in of_longest),
        steady_s=sum(run.steady_s for run in of_longest) / len(of_longest),
        strength=keep_kernel(strength),
        stress=keep_kernel(stress),
        unloading=None if unloading is None else keep_kernel(unloading),
    )
