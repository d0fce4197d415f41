"""What most tests of this room image: a round sensor with pins, on elements large enough to be quick."""

import pytest
from round_sensors import MakeSensor

from cbsr_qa.domain.imaging import ImagingProblem
from cbsr_qa.domain.sensor.sensor_type import SensorType
from cbsr_qa.eit.inverse.problem import imaging_problem


@pytest.fixture(scope="session")
def sensor(pin_sensor: MakeSensor) -> SensorType:
    return pin_sensor()


@pytest.fixture(scope="session")
def problem(sensor: SensorType) -> ImagingProblem:
    return imaging_problem(sensor, image_size_mm=6.0)
