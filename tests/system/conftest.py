"""Lets the tests of whole commands share ``command.py``."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
