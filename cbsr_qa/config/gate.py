"""``[gate]`` of a station file: the checks before a run."""

from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Final, Literal

from pydantic import Field

from cbsr_qa.config.serials import validate_operator
from cbsr_qa.config.tables import as_domain
from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.plan.gate import GateCheck, GatePolicy, GateSettings, Operator
from cbsr_qa.plugin.problems import Problem, Table
from cbsr_qa.system.pins import pin_hash_readable

Policy = Literal["refuse", "warn", "off"]
Count = Annotated[int, Field(ge=1, le=1_000_000)]
#: Key of the list of operators. The list is left out of the stored configuration of a run: a station measures the
#: same with any operator, and the hashes of PINs stay out of the database.
OPERATORS: Final = "operators"


class OperatorTable(Table):
    """``[[gate.operators]]``."""

    name: Annotated[str, Field(min_length=1, max_length=64)]
    pin: Any = None  # checked below: no message may repeat it

    def problems(self, number: int) -> Iterator[Problem]:
        path = ("gate", OPERATORS, number)
        try:
            validate_operator(self.name)
        except ConfigError as error:
            yield Problem((*path, "name"), f"cannot be used: {error.reason}", error.remedy)
        if self.pin is not None and not pin_hash_readable(self.pin):
            yield Problem((*path, "pin"), "is no hash of a PIN", "copy the line that cbsr-qa station pin prints")


class GateTable(Table):
    """``[gate]``: a policy for each check, and what the checks require."""

    serial_pattern: Policy | None = None
    retest: Policy | None = None
    retest_runs: Count | None = None
    parts: Policy | None = None
    calibration_due: Policy | None = None
    golden: Policy | None = None
    golden_hours: Annotated[float, Field(gt=0, le=87600)] | None = None
    golden_runs: Count | None = None
    charts: Policy | None = None
    disk: Policy | None = None
    disk_GB: Annotated[float, Field(gt=0, le=1e6)] | None = None
    operator: Policy | None = None
    operators: list[OperatorTable] = Field(default_factory=list)
    released: Policy | None = None
    backlog: Policy | None = None
    before_run: Policy | None = None
    before_run_s: Annotated[float, Field(gt=0, le=600)] = 10.0

    def problems(self) -> Iterator[Problem]:
        """A check that is on has what it needs; no operator is listed twice."""
        if self.golden not in (None, "off") and self.golden_hours is None and self.golden_runs is None:
            yield Problem(("gate", "golden"), "needs golden_hours or golden_runs, or both")
        if self.operator not in (None, "off") and OPERATORS not in self.model_fields_set:
            yield Problem(("gate", "operator"), "needs a list: one [[gate.operators]] table with a name for each")
        names = [operator_table.name for operator_table in self.operators]
        for number, operator_table in enumerate(self.operators):
            yield from operator_table.problems(number)
            if operator_table.name in names[:number]:
                yield Problem(("gate", OPERATORS, number, "name"), f"{operator_table.name!r} is listed before")

    def to_domain(self, overdue: str | None) -> GateSettings:
        """Return the settings; ``overdue`` is the earlier spelling of ``calibration_due``."""
        policy_by_check = {check: getattr(self, check) for check in GateCheck}
        policy_by_check[GateCheck.CALIBRATION_DUE] = self.calibration_due or overdue
        return as_domain(
            GateSettings,
            self,
            policies={check: GatePolicy(policy) for check, policy in policy_by_check.items() if policy is not None},
            operators=tuple(
                Operator(operator_table.name, operator_table.pin or "") for operator_table in self.operators
            ),
        )


def empty_operators(data: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the content of a station file with an empty list of operators, if it has a list."""
    gate = data.get("gate")
    if not isinstance(gate, Mapping) or OPERATORS not in gate:
        return data
    return {**data, "gate": {**gate, OPERATORS: []}}
