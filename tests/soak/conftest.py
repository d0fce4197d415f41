"""Long tests, run by ``make soak`` alone; they share the kit of the tests of whole commands."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "system"))
