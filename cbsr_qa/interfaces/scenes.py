"""Effects of the simulated world."""

from typing import Protocol, runtime_checkable

from cbsr_qa.domain.scene import Moment, SheetDesign, Transcript


@runtime_checkable
class Effect(Protocol):
    """One physical effect of a scene. An effect that is off is not imported."""

    @property
    def needs(self) -> tuple[str, ...]:
        """Effects that must be on and come before this one."""
        ...

    @property
    def perturbs(self) -> str:
        """A stage of the moment; :data:`cbsr_qa.simulate.chain.STAGES` lists them."""
        ...

    def apply(self, moment: Moment) -> None:
        """Change the moment. Random numbers come from the stream of (seed, own name, ``moment.index``)."""
        ...


@runtime_checkable
class SwitchingEffect(Protocol):
    """What an effect of the stage ``impedance`` that changes in steps has as well."""

    def switches(self, moment: Moment, first_s: float, last_s: float) -> list[float]:
        """Times of its steps after the first and up to the last [s]; at such a time the step is over."""
        ...


@runtime_checkable
class SheetEffect(Protocol):
    """An effect on the sheet as it is made (stage ``sheet``)."""

    @property
    def needs(self) -> tuple[str, ...]:
        """Effects that must be on and come before this one."""
        ...

    @property
    def perturbs(self) -> str:
        """The stage ``sheet``."""
        ...

    def design(self, design: SheetDesign) -> None:
        """Change the sheet before it is made. Random numbers come from the stream of (seed, own name, 0)."""
        ...


@runtime_checkable
class RecordingEffect(Protocol):
    """An effect on how a scene's frames are written down (stage ``recording``)."""

    @property
    def needs(self) -> tuple[str, ...]:
        """Effects that must be on and come before this one."""
        ...

    @property
    def perturbs(self) -> str:
        """The stage ``recording``."""
        ...

    def record(self, transcript: Transcript) -> None:
        """Change the transcript. Random numbers come from the stream of (seed, own name, frame)."""
        ...


#: What a scene's effects may be.
AnyEffect = Effect | SheetEffect | RecordingEffect
