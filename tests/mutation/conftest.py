"""Files are changed that the tests of each kind of file make."""

import sys
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parents[1] / folder) for folder in ("unit", "recordings")]
