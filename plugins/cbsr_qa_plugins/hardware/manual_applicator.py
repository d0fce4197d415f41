"""A head that an operator moves by hand: a stand with a spindle and scales, or weights put on a guided plunger."""

from typing import Annotated, Final

from pydantic import Field

from cbsr_qa.plugin import InstrumentIdentity, PluginOptions, StationContext, driver
from cbsr_qa_plugins.hardware._driver import RIG_MOTION, DriverBase, Text
from cbsr_qa_plugins.hardware.manual_samplers import Operator

_DRIVER: Final = "manual-applicator"
#: A depth that was missed so often is not going to be met.
_MAX_PRESSES: Final = 5


class ManualHeadOptions(PluginOptions):
    label: Text = "head moved by hand"
    number: Text | None = None
    tolerance_mm: Annotated[float, Field(ge=1e-3, le=1)] = 0.05


@driver(_DRIVER, ManualHeadOptions)
def open_applicator(context: StationContext, options: ManualHeadOptions) -> "ManualApplicator":
    """Open a head that is moved by hand.

    Options of its table
    --------------------
    label, number : name and serial number of the stand, for the record.
    tolerance_mm : allowed difference between a depth and the requested one.

    Raises
    ------
    ConfigError
        If an option is wrong, or there is no operator to be asked.
    """
    return ManualApplicator(context, options)


class ManualApplicator(DriverBase):
    """Asks for every movement, and takes the head to be where the operator says.

    Depths are read from a scale that is zero at the hover height and grows downwards.
    """

    def __init__(self, context: StationContext, options: ManualHeadOptions) -> None:
        super().__init__(context, _DRIVER, "the operator")
        self._operator = Operator(context, _DRIVER)
        self._motion = context.motion or RIG_MOTION
        self._options = options
        self._surfaces: dict[tuple[float, float], float] = {}
        self._place: tuple[float, float] | None = None
        self._down = False
        self._orders = 0

    # --- instrument ---

    def identity(self) -> InstrumentIdentity:
        """Return the identity in the table: the stand has no query."""
        return self._build_identity(self._options.label, self._options.number or "")

    def safe_state(self) -> None:
        """Report that a head which is down can only be lifted by hand, without waiting for an operator.

        InstrumentError if the head is down according to the orders.
        """
        if self._down:
            raise self._error("the head is down and is moved by hand: LIFT IT NOW")

    # --- moved by hand ---

    @property
    def orders(self) -> int:
        """Number of orders to move."""
        return self._orders

    @property
    def down(self) -> bool:
        """Whether it is in the sheet according to the orders."""
        return self._down

    # --- force applicator ---

    def home(self) -> None:
        """Ask for the head to be lifted, and for its scales to be set to zero over the sheet's centre."""
        self._orders += 1
        hover = f"{self._motion.hover_mm:g} mm above the sheet"
        self._operator.request_action(
            f"lift the head to {hover}, bring it over the sheet's centre and set its scales to zero"
        )
        self._place, self._down = (0.0, 0.0), False
        self._surfaces.clear()  # the scale they were read from has a new zero

    def find_surface(self, x_mm: float, y_mm: float) -> float:
        """Ask for the depth at which the head just touches; the head is up again when it is answered."""
        self.move_to(x_mm, y_mm)
        self._down = True
        depth_mm = self._operator.number(
            f"lower the head until it just touches the sheet at {_words((x_mm, y_mm))}, read its depth below the"
            " hover height, and lift it again; the depth",
            "mm",
            least=1e-3,
            most=2 * self._motion.hover_mm,
        )
        self._down = False
        self._surfaces[(x_mm, y_mm)] = depth_mm
        return depth_mm

    def move_to(self, x_mm: float, y_mm: float) -> None:
        """Ask for the head to be brought over a place, lifting it first if it is down."""
        self.release()
        self._orders += 1
        if self._place != (x_mm, y_mm):
            self._place = None  # until it is answered, it may be anywhere between
            self._operator.request_action(f"bring the head over {_words((x_mm, y_mm))}, at the hover height")
            self._place = (x_mm, y_mm)

    def press(self, depth_mm: float, speed_mm_s: float) -> None:
        """Ask for a depth below the surface found here (or else found nearest, or else hover height).

        InstrumentError if the depth was missed again and again: the head is then down, wherever it is.
        """
        self._orders += 1
        scale_mm = self._surface_mm() + depth_mm
        self._down = True
        order = f"{'go' if depth_mm else 'come'} to {depth_mm:g} mm below the surface at {60 * speed_mm_s:.3g} mm/min"
        for _ in range(_MAX_PRESSES):
            found_mm = self._operator.number(
                f"{order}: {scale_mm:.2f} mm on the scale. What the scale says (Enter: exactly that)",
                "mm",
                least=0.0,
                most=3 * self._motion.hover_mm,
                default=scale_mm,
            )
            if abs(found_mm - scale_mm) <= self._options.tolerance_mm:
                return
            order = f"{found_mm:g} mm is {found_mm - scale_mm:+.2f} mm off; go straight to {depth_mm:g} mm"
        raise self._error(
            f"the head was told to be at {scale_mm:.2f} mm on its scale and was last at {found_mm:.2f} mm",
            "tolerance_mm in its table says how near it must come",
        )

    def release(self) -> None:
        """Request to lift a head that is down."""
        if self._down:
            self._orders += 1
            self._operator.request_action("lift the head straight up to the hover height")
            self._down = False

    def _surface_mm(self) -> float:
        """Depth of the surface on the scale, here or where found nearest; nominal where found nowhere."""
        if not self._surfaces:
            return self._motion.hover_mm
        if self._place in self._surfaces:
            return self._surfaces[self._place]
        x, y = self._place or (0.0, 0.0)
        return self._surfaces[min(self._surfaces, key=lambda place: (place[0] - x) ** 2 + (place[1] - y) ** 2)]


def _words(place: tuple[float, float]) -> str:
    return f"x = {place[0]:g} mm, y = {place[1]:g} mm from the sheet's centre"
