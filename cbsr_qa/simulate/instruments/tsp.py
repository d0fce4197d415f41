"""The subset of TSP (the Lua of Keithley's 2600 series) that drivers use."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final, Protocol

#: Codes of the instrument's error queue.
SYNTAX_ERROR: Final = -285
RUNTIME_ERROR: Final = -286

_TOKEN: Final = re.compile(
    r"\s*(?:(?P<number>-?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)|(?P<name>[A-Za-z_]\w*(?:\.[A-Za-z_]\w*)*)"
    r'|"(?P<text>[^"\\]*)"|(?P<sign>[(),=]))'
)
_KEYWORDS: Final = frozenset({"function", "for", "do", "end"})
_CONSTANTS: Final = {"true": True, "false": False, "nil": None}

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
        ...

    def assign(self, name: str, value: Any) -> None:
        """Set an attribute; TspError if it is read-only, or the value is not allowed."""
        ...

    def call(self, name: str, arguments: Sequence[Any]) -> tuple[Any, ...]:
        """Call a built-in function; TspError if it does not exist."""
        ...


@dataclass(frozen=True, slots=True)
class _Function:
    parameters: tuple[str, ...]
    body: tuple[Statement, ...]


class Interpreter:
    """Interpreter of one line at a time. A line is parsed completely before it runs."""

    def __init__(self, machine: Machine) -> None:
        self._machine = machine
        self._functions: dict[str, _Function] = {}

    def run(self, line: str) -> None:
        """Run a line.

        TspError -285 for a syntax error (nothing is run), -286 or the machine's error if the line fails.
        """
        parser = _Parser(line, self)
        statements = parser.block(within=False)
        for statement in statements:
            statement({})

    def define(self, name: str, parameters: tuple[str, ...], body: tuple[Statement, ...]) -> None:
        self._functions[name] = _Function(parameters, body)

    def named(self, name: str, local: Locals) -> Any:
        if name in _CONSTANTS:
            return _CONSTANTS[name]
        return local[name] if name in local else self._machine.value(name)

    def assign(self, name: str, value: Any) -> None:
        self._machine.assign(name, value)

    def call(self, name: str, arguments: tuple[Any, ...]) -> tuple[Any, ...]:
        """Call a user-defined function, or else a built-in one."""
        function = self._functions.get(name)
        if function is None:
            return self._machine.call(name, arguments)
        local = dict(zip(function.parameters, arguments, strict=False))
        for statement in function.body:
            statement(local)
        return ()


class _Parser:
    def __init__(self, line: str, interpreter: Interpreter) -> None:
        self._tokens = _tokens(line)
        self._at = 0
        self._interpreter = interpreter

    def block(self, *, within: bool) -> tuple[Statement, ...]:
        statements: list[Statement] = []
        while self._peek() != ("end", "end"):
            if self._peek() == ("", ""):
                if within:
                    raise self._unexpected()
                return tuple(statements)
            statements.append(self._statement())
        if not within:
            raise self._unexpected()
        return tuple(statements)

    def _statement(self) -> Statement:
        kind, text = self._next()
        if kind == "function":
            return self._definition()
        if kind == "for":
            return self._loop()
        if kind != "name":
            self._at -= 1
            raise self._unexpected()
        if self._peek()[1] == "(":
            return self._call(text)
        self._expect("=")
        value, interpreter = self._expression(), self._interpreter
        return lambda local: interpreter.assign(text, _one(value(local)))

    def _definition(self) -> Statement:
        name = self._expect("name")
        self._expect("(")
        parameters: list[str] = []
        while self._peek()[1] != ")":
            parameters.append(self._expect("name"))
            if self._peek()[1] == ",":
                self._next()
        self._expect(")")
        body = self.block(within=True)
        self._expect("end")
        return lambda _: self._interpreter.define(name, tuple(parameters), body)

    def _loop(self) -> Statement:
        variable = self._expect("name")
        self._expect("=")
        first = self._expression()
        self._expect(",")
        last = self._expression()
        self._expect("do")
        body = self.block(within=True)
        self._expect("end")

        def run(local: Locals) -> None:
            for number in range(int(_one(first(local))), int(_one(last(local))) + 1):
                local[variable] = number
                for statement in body:
                    statement(local)

        return run

    def _call(self, name: str) -> Expression:
        self._expect("(")
        arguments: list[Expression] = []
        while self._peek()[1] != ")":
            arguments.append(self._expression())
            if self._peek()[1] != ")":
                self._expect(",")
        self._expect(")")
        interpreter = self._interpreter

        def run(local: Locals) -> tuple[Any, ...]:
            values: list[Any] = [_one(argument(local)) for argument in arguments[:-1]]
            for argument in arguments[-1:]:  # of the last argument all values count, as in Lua
                values += argument(local)
            return interpreter.call(name, tuple(values))

        return run

    def _expression(self) -> Expression:
        kind, text = self._next()
        if kind == "number":
            number = float(text)
            return lambda _: (number,)
        if kind == "text":
            return lambda _: (text,)
        if kind != "name":
            self._at -= 1
            raise self._unexpected()
        if self._peek()[1] == "(":
            return self._call(text)
        interpreter = self._interpreter
        return lambda local: (interpreter.named(text, local),)

    def _peek(self) -> tuple[str, str]:
        return self._tokens[self._at]

    def _next(self) -> tuple[str, str]:
        self._at += 1
        return self._tokens[self._at - 1]

    def _expect(self, wanted: str) -> str:
        kind, text = self._peek()
        if wanted not in (kind, text) or (kind == "text" and wanted != "text"):
            raise self._unexpected()
        return self._next()[1]

    def _unexpected(self) -> TspError:
        near = self._peek()[1] or "<eof>"
        return TspError(SYNTAX_ERROR, f"TSP Syntax error at line 1: unexpected symbol near `{near}'")


def _one(values: tuple[Any, ...]) -> Any:
    return values[0] if values else None


def _tokens(line: str) -> list[tuple[str, str]]:
    """Split a line into (kind, text); keywords are their own kind, the end is two empty texts."""
    tokens: list[tuple[str, str]] = []
    at = 0
    line = line.rstrip()
    while at < len(line):
        match = _TOKEN.match(line, at)
        if match is None:
            raise TspError(
                SYNTAX_ERROR, f"TSP Syntax error at line 1: unexpected symbol near `{line[at:].strip()[:1]}'"
            )
        kind = str(match.lastgroup)
        text = match[kind]
        tokens.append((text if text in _KEYWORDS and kind == "name" else kind, text))
        at = match.end()
    return [*tokens, ("", "")]
