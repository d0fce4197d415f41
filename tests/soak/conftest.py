"""Long tests, run by ``make soak`` alone; they share the kits of other tests."""

import sys
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parents[1] / folder) for folder in ("system", "mutation", "unit", "recordings")]
