"""What is masked before two commits are compared, because it differs between two runs of one commit."""

import re
from collections.abc import Mapping
from datetime import date, timedelta
from typing import Final

_HEX = "[0-9a-f]"
_PACKAGE: Final = r"cbsr_qa(?:_plugins)?"
_SPAN: Final = r"[\d.]+ (?:h|min|s)(?: [\d.]+ (?:min|s))?\b"
_PROGRAMS = "cbsr[-_]qa|numpy|scipy|h5py|python|Python|matplotlib|scikit-image|oracle-killer"

#: Pattern → what stands in its place. Identities and times are masked first, by these; folders by :func:`masked`.
MASKS: Final = tuple(
    (re.compile(pattern), mask)
    for pattern, mask in (
        # Times of the wall clock.
        (r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d(:\d\d(\.\d+)?)?(Z|\+00:00| UTC)?", "<time>"),
        # Limits that were proposed: the day, and a digest of the runs they rest on.
        (rf"\b\d{{4}}-\d\d-\d\d-{_HEX}{{8}}\b", "<day>-<digest>"),
        (rf"SHA-256 {_HEX}{{16}}…", "SHA-256 <digest>…"),
        # The page of a recording is named by a digest of the file and its settings; the file may hold identities.
        (rf"-{_HEX}{{8}}(?=\.html)", "-<digest>"),
        # How long this computer took: `"compute_s": [["imaging", 1.2]]`, "4.3 s of computing".
        (rf"{_SPAN} of computing", "<s> of computing"),
        (rf"{_SPAN} to compute the result", "<s> to compute the result"),
        (rf"computing took {_SPAN}", "computing took <s>"),
        (r'(<div role="img" aria-label="[^"]*computing took[^"]*">)(\s|.)*?</svg>', r"\1 <a figure of times>"),
        (r"(?m)^[^\n:]+: \d+ s \((\d+) of (\d+)\)$", r"<one of them>: <s> (\1 of \2)"),
        # What the effects of a scene cost: "time-skew   0.487 ##  share = 1", "a frame takes 0.430 ms; … 0.35 s".
        (r"(?m)^( {2,}[a-z]* +[a-z-]+) +\d+\.\d{3}(?: #*(?= |$)|$| (?=once)) *", r"\1 <ms> "),
        (r"a frame takes [\d.]+ ms; (.*) about [\d.]+ s", r"a frame takes <ms>; \1 about <s>"),
        (r'("(?:compute_s|seconds|cost_ms_per_frame|frame_ms)": )[\d.e+-]+', r"\1<s>"),
        # Names within a drawing, which are drawn at random.
        (r"\bf[0-9a-f]{8}-(\w+)", r"<drawing>-\1"),
        # Versions of the program and of what it needs.
        (
            rf'({_PROGRAMS})([ =:]+|", ")v?\d+(\.\d+)+\w*',
            r"\1 <version>",
        ),
        # Where a line of the program stands, in a traceback, a warning or a message.
        (r"\((\w+\.py), line \d+\)", "(<file>, line <n>)"),
        (rf"(?:<checkout>/)?\b{_PACKAGE}(?:/\w+)+\.py", "<file>"),
        (r'(<file>"?)(, line |:)\d+', r"\1\2<n>"),
        (rf"\b{_PACKAGE}(?:\.\w+)+(?::\w+)?", "<module>"),
        # Columns are as wide as what they hold: a longer name moves all that is beside it.
        (r"(?m)(?<=\S) {2,}(?=.*<(?:module|file|version)>)|(?<=<module>) {2,}|(?<=<version>) {2,}", "  "),
    )
)
UUID = re.compile(rf"{_HEX}{{8}}-{_HEX}{{4}}-{_HEX}{{4}}-{_HEX}{{4}}-{_HEX}{{12}}")
#: `"compute_s": {"imaging": 1.2, …}`, `"compute_s": [["imaging", 1.2], …]`
_PARTS: Final = re.compile(r'"compute_s": (?:\{[^{}]*\}|\[(?:[^][]|\[[^][]*\])*\])')
_NUMBER: Final = re.compile(r"(?<=[\s:,[])\d[\d.e+-]*")
_DAY: Final = re.compile(r"\b\d{4}-\d\d-\d\d\b")
#: Digests cover identities and times; those of content are compared through what is dumped.
_SHA256 = re.compile(rf"\b{_HEX}{{64}}\b")


def masked(text: str, folders: Mapping[str, str]) -> str:
    """Replace what differs between two runs of one commit.

    Parameters
    ----------
    folders : path → what stands in its place, the longest first.
    """
    for folder in sorted(folders, key=len, reverse=True):
        text = text.replace(folder, folders[folder])
    numbers: dict[str, int] = {}
    text = UUID.sub(lambda found: f"<id-{numbers.setdefault(found[0], len(numbers) + 1)}>", text)
    text = _SHA256.sub("<sha256>", text)
    text = _PARTS.sub(lambda found: _NUMBER.sub("<s>", found[0]), text)
    for pattern, mask in MASKS:
        text = pattern.sub(mask, text)
    return _DAY.sub(_day, text)


def _day(found: re.Match[str]) -> str:
    """Mask a day on which a case may have been run; days that were given stay."""
    try:
        age = date.today() - date.fromisoformat(found[0])
    except ValueError:
        return found[0]
    return "<day>" if timedelta(0) <= age <= timedelta(days=7) else found[0]
