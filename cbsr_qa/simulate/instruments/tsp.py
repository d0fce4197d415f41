"""The subset of TSP (the Lua of Keithley's 2600 series) that drivers use."""

import re
from collections.abc import Callable, Sequence
from typing import Any, Final, Protocol, TypeVar

#: Codes of the instrument's error queue.
SYNTAX_ERROR: Final = -285
RUNTIME_ERROR: Final = -286

_TOKEN: Final = re.compile(
    r"(?:(?P<number>-?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)|(?P<name>[A-Za-z_]\w*(?:\.[A-Za-z_]\w*)*)"
    r'|"(?P<text>[^"\\]*)"|(?P<sign>[(),=]))'
)
_KEYWORDS: Final = frozenset({"function", "for", "do", "end"})
_CONSTANTS: Final = {"true": True, "false": False, "nil": None}

T = TypeVar("T")
Locals = dict[str, Any]
Statement = Callable[[Locals], object]
Expression = Callable[[Locals], tuple[Any, ...]]


class TspError(Exception):
    """Error of a line that was rejected or stopped; goes into the instrument's error queue."""

    def __init__(self, code: int, message: str) -> None:
        super().__init__(message)
        self.code = code


class Machine(Protocol):
    """The machine that the language controls. Names have dots: ``smua.source.leveli``."""

    def value(self, name: str) -> Any:
        """Return the value of a name; TspError if it is undefined."""

    def assign(self, name: str, value: Any) -> None:
        """Set an attribute; TspError if it is read-only, or the value is not allowed."""

    def call(self, name: str, arguments: Sequence[Any]) -> tuple[Any, ...]:
        """Call a built-in function; TspError if it does not exist."""


class Interpreter:
    """Interpreter of one line at a time. A line is parsed completely before it runs."""

    def __init__(self, machine: Machine) -> None:
        self._machine = machine
        self._functions: dict[str, tuple[list[str], list[Statement]]] = {}

    def run(self, line: str) -> None:
        """Run a line.

        TspError -285 for a syntax error (nothing is run), -286 or the machine's error if the line fails.
        """
        self._tokens = _tokens(line)
        _execute(self._block(""), {})

    # --- statements ---

    def _block(self, end: str) -> list[Statement]:
        """Parse statements up to a keyword, or to the end of the line."""
        statements: list[Statement] = []
        while self._tokens[0][0] != end:
            statements.append(self._statement())
        self._expect(end)
        return statements

    def _statement(self) -> Statement:
        if self._take_token("function"):
            function = self._expect("name")
            parameters, body = self._parse_list(lambda: self._expect("name")), self._block("end")
            return lambda _: self._functions.update({function: (parameters, body)})
        if self._take_token("for"):
            return self._loop()
        name = self._expect("name")
        if self._tokens[0] == ("sign", "("):
            return self._call(name)
        self._expect("=")
        value = self._expression()
        return lambda local: self._machine.assign(name, _first(value(local)))

    def _loop(self) -> Statement:
        variable, _, start = self._expect("name"), self._expect("="), self._expression()
        _, stop, _ = self._expect(","), self._expression(), self._expect("do")
        body = self._block("end")

        def run(local: Locals) -> None:
            for number in range(int(_first(start(local))), int(_first(stop(local))) + 1):
                _execute(body, {**local, variable: number})

        return run

    # --- expressions ---

    def _expression(self) -> Expression:
        if number := self._take_token("number"):
            return lambda _: (float(number),)
        if self._tokens[0][0] == "text":
            text = self._expect("text")
            return lambda _: (text,)
        name = self._expect("name")
        if self._tokens[0] == ("sign", "("):
            return self._call(name)

        def look_up(local: Locals) -> tuple[Any, ...]:
            values = {**local, **_CONSTANTS}
            return (values[name] if name in values else self._machine.value(name),)

        return look_up

    def _call(self, name: str) -> Expression:
        """Parse the call of a user-defined function, or else of a built-in one."""
        arguments = self._parse_list(self._expression)

        def run(local: Locals) -> tuple[Any, ...]:
            values: list[Any] = [_first(argument(local)) for argument in arguments[:-1]]
            for argument in arguments[-1:]:  # of the last argument all values count, as in Lua
                values += argument(local)
            if name not in self._functions:
                return self._machine.call(name, values)
            parameters, body = self._functions[name]
            _execute(body, dict(zip(parameters, values, strict=False)))
            return ()

        return run

    # --- tokens ---

    def _parse_list(self, parse: Callable[[], T]) -> list[T]:
        """Parse what stands in parentheses, with commas between."""
        self._expect("(")
        items: list[T] = []
        while not self._take_token(")"):
            if items:
                self._expect(",")
            items.append(parse())
        return items

    def _take_token(self, wanted: str) -> str:
        """Take the next token if it is of this kind or this sign; else nothing."""
        kind, text = self._tokens[0]
        return self._tokens.pop(0)[1] if wanted == kind or (kind, wanted) == ("sign", text) else ""

    def _expect(self, wanted: str) -> str:
        kind, text = self._tokens[0]
        if wanted != kind and (kind, wanted) != ("sign", text):
            raise _syntax_error(text or "<eof>")
        return self._tokens.pop(0)[1]


def _execute(statements: Sequence[Statement], local: Locals) -> None:
    for statement in statements:
        statement(local)


def _first(values: tuple[Any, ...]) -> Any:
    return values[0] if values else None


def _syntax_error(near: str) -> TspError:
    return TspError(SYNTAX_ERROR, f"TSP Syntax error at line 1: unexpected symbol near `{near}'")


def _tokens(line: str) -> list[tuple[str, str]]:
    """Split a line into (kind, text); keywords are their own kind, the end is two empty texts."""
    tokens: list[tuple[str, str]] = []
    remaining = line.strip()
    while remaining:
        match = _TOKEN.match(remaining)
        if match is None:
            raise _syntax_error(remaining[:1])
        kind = str(match.lastgroup)
        text = match[kind]
        tokens.append((text if text in _KEYWORDS and kind == "name" else kind, text))
        remaining = remaining[match.end() :].lstrip()
    return [*tokens, ("", "")]
