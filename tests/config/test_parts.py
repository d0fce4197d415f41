"""Parts of a sensor as they are typed or scanned."""

import pytest

from cbsr_qa.config.serials import read_parts
from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.sensor.sensor_type import SensorPart


def test_parts_are_sorted_by_name_and_the_revision_is_after_the_last_slash():
    assert read_parts(["sheet=LOT7/B", "board=PN 4/2/C", "silicone=Ü=3"]) == (
        SensorPart("board", "PN 4/2", "C"),
        SensorPart("sheet", "LOT7", "B"),
        SensorPart("silicone", "Ü=3"),
    )
    assert [str(part) for part in read_parts(["sheet=LOT7/B", "board=9"])] == ["board=9", "sheet=LOT7/B"]
    assert read_parts([]) == ()


@pytest.mark.parametrize(
    ("texts", "said"),
    [
        (["LOT7"], "part 'LOT7' has no ="),
        (["=LOT7"], "name of a part '' cannot be used: it is empty"),
        (["sh eet=LOT7"], "name of a part 'sh eet' cannot be used: ' ' is not allowed"),
        (["sheet="], "identifier '' of part sheet is empty"),
        (["sheet=/B"], "identifier '' of part sheet is empty"),
        (["sheet=LOT7/"], "revision '' of part sheet is empty"),
        (["sheet= LOT7"], "identifier ' LOT7' of part sheet starts or ends with a blank"),
        (["sheet=LOT\x1b7"], "identifier 'LOT\\x1b7' of part sheet has the character '\\x1b'"),
        (["sheet=LOT7/B\n"], "revision 'B\\n' of part sheet starts or ends with a blank"),
        ([f"sheet={'7' * 65}"], "(65 characters) of part sheet is longer than 64 characters"),
        ([f"{'s' * 65}=7"], "it is longer than 64 characters"),
        (["sheet=LOT7", "sheet=LOT8/B"], "part sheet is given twice: sheet=LOT7 and sheet=LOT8/B"),
    ],
)
def test_odd_input_is_named(texts, said):
    with pytest.raises(ConfigError) as caught:
        read_parts(texts)
    assert said in str(caught.value)


@pytest.mark.parametrize(
    ("selection", "selected"),
    [
        ("sheet=LOT7", True),
        ("sheet=LOT7/B", True),
        ("sheet=LOT7/C", False),
        ("sheet=LOT8", False),
        ("board=LOT7", False),
    ],
)
def test_a_selection_without_revision_means_any(selection, selected):
    (wanted,), (part,) = read_parts([selection]), read_parts(["sheet=LOT7/B"])
    assert wanted.selects(part) is selected
