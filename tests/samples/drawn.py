"""How many examples hypothesis draws for a property, and how: by the tier of tests that runs it."""

import os

from hypothesis import settings

#: Examples of each tier, in parts of the number that a test states; a test that states none has hypothesis's 100.
SHARES = {"test": 0.2, "rest": 1.0, "soak": 10.0}
#: Few enough to be quick, and enough that a property which is broken everywhere is seen.
LEAST = 5

_TIER = os.environ.get("CBSR_QA_TIER", "rest")
if _TIER not in SHARES:
    raise ValueError(f"CBSR_QA_TIER is {_TIER!r}; allowed: {', '.join(SHARES)}")


def drawn(examples: int = 100, **more: object) -> settings:
    """Return the settings of a property that is tried on so many examples.

    They are the same ones every time, so that a change of the code alone makes a test fail; ``make soak`` draws at
    random, and ten times as many. What is drawn is judged by what comes of it; how long it takes is the computer's,
    and measured in benchmarks/.
    """
    count = max(min(LEAST, examples), round(SHARES[_TIER] * examples))
    chance = _TIER == "soak"
    # A database of failures is for what was drawn at random: the same examples fail again without it.
    kept = {} if chance else {"database": None}
    return settings(max_examples=count, derandomize=not chance, deadline=None, **kept, **more)
