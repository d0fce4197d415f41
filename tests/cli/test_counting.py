"""Progress of counted work: a bar on a terminal, one line a stage elsewhere, nothing left behind."""

import io

from cbsr_qa.cli.output import Counting


class Terminal(io.StringIO):
    def isatty(self):
        return True


def _shown(stream):
    with Counting("frames", stream=stream) as counting:
        counting.stage("simulating")
        for done in range(1, 4):
            counting.count(done, 3)
        counting.stage("writing")
    return stream.getvalue()


def test_elsewhere_there_is_one_line_a_stage():
    assert _shown(io.StringIO()) == "simulating …\nwriting …\n"


def test_on_a_terminal_there_is_a_bar_that_goes_away():
    said = _shown(Terminal())
    assert "frames" in said
    assert said.index("simulating …") < said.index("frames") < said.index("writing …")
    assert said.endswith("writing …\n")
