"""Changes of one token in functions, and how a process loads a module with one of them.

:mod:`mutants` draws them and runs tests on them. Every Python process whose environment names a file in
``CBSR_QA_MUTANTS`` loads this one first, subprocesses of tests too; the checkout stays as it is.
"""

import ast
import copy
import inspect
import json
import os
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.machinery import SourceFileLoader
from pathlib import Path

#: Name of the environment's variable: a JSON file, see :func:`install`.
VARIABLE = "CBSR_QA_MUTANTS"

_COMPARISONS: dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}
_ARITHMETIC: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
}
# What only words a message, declares a type or runs when the module is loaded.
_SKIPPED_NODES = (ast.Raise, ast.Assert, ast.JoinedStr, ast.arguments)
_SKIPPED_FIELDS = ("annotation", "returns", "decorator_list")
_SPEAKING = ("warn", "warning", "info", "debug", "error", "exception", "print")


@dataclass(frozen=True, slots=True)
class Site:
    """One change of a function: its kind, what stood there, and how to make it in the tree it was found in."""

    kind: str
    line: int
    before: str
    after: str
    statement: ast.stmt
    make: Callable[[], None]


def functions(module: ast.Module) -> Iterator[tuple[str, ast.FunctionDef]]:
    """Yield functions and methods by qualified name; a function within one is part of it."""

    def inside(body: list[ast.stmt], prefix: str) -> Iterator[tuple[str, ast.FunctionDef]]:
        for node in body:
            if isinstance(node, ast.FunctionDef):
                yield prefix + node.name, node
            elif isinstance(node, ast.ClassDef):
                yield from inside(node.body, f"{prefix}{node.name}.")

    return inside(module.body, "")


def sites(function: ast.FunctionDef) -> list[Site]:
    """Return all changes of a function, in the order of its text; none where it only words something."""
    words = isinstance(function.returns, ast.Name) and function.returns.id == "str"
    if function.name in {"__repr__", "__str__"} or (
        words and any(isinstance(node, ast.JoinedStr) for node in ast.walk(function))
    ):
        return []
    return list(_below(function, function))


def _below(parent: ast.AST, statement: ast.stmt) -> Iterator[Site]:
    for field, value in ast.iter_fields(parent):
        if field in _SKIPPED_FIELDS:
            continue
        for index, node in enumerate(value if isinstance(value, list) else [value]):
            if not isinstance(node, ast.AST) or isinstance(node, _SKIPPED_NODES) or _speaks(node):
                continue
            within = node if isinstance(node, ast.stmt) else statement
            for kind, changed in _changes(node):
                place = index if isinstance(value, list) else None
                before, after = (_shown(one) for one in (node, changed))
                yield Site(kind, node.lineno, before, after, within, _replacing(parent, field, place, changed))
            yield from _below(node, within)


def _speaks(node: ast.AST) -> bool:
    if not isinstance(node, ast.Call):
        return False
    name = getattr(node.func, "attr", getattr(node.func, "id", ""))
    return name in _SPEAKING or name.endswith("Error")


def _shown(node: ast.AST) -> str:
    return ast.unparse(node.test if isinstance(node, ast.If | ast.While | ast.IfExp) else node)


def _replacing(parent: ast.AST, field: str, index: int | None, changed: ast.AST) -> Callable[[], None]:
    def make() -> None:
        if index is None:
            setattr(parent, field, changed)
        else:
            getattr(parent, field)[index] = changed

    return make


def _changes(node: ast.AST) -> Iterator[tuple[str, ast.AST]]:  # noqa: C901 - one branch a kind of node
    def but(**fields: object) -> ast.AST:
        changed = copy.copy(node)
        for name, value in fields.items():
            setattr(changed, name, value)
        return changed

    match node:
        case ast.Compare(ops=operators):
            for place, operator in enumerate(operators):
                for other in _COMPARISONS[type(operator)]:
                    yield "comparison", but(ops=[*operators[:place], other(), *operators[place + 1 :]])
        case ast.BinOp(op=operator) | ast.AugAssign(op=operator) if type(operator) in _ARITHMETIC:
            if not any(isinstance(one, ast.JoinedStr) or _text(one) for one in ast.iter_child_nodes(node)):
                yield "arithmetic", but(op=_ARITHMETIC[type(operator)]())
        case ast.BoolOp(op=operator):
            yield "and, or", but(op=ast.Or() if isinstance(operator, ast.And) else ast.And())
        case ast.UnaryOp(op=ast.Not(), operand=operand):
            yield "not", operand
        case ast.Constant(value=value) if type(value) is int:
            yield "constant", but(value=value + 1)
        case ast.Constant(value=value) if type(value) is float:
            yield "constant", but(value=1.5 * value if value else 1.0)
        case ast.If(test=test) | ast.While(test=test) | ast.IfExp(test=test):
            if not isinstance(test, ast.Compare | ast.BoolOp | ast.UnaryOp):
                yield "condition", but(test=ast.UnaryOp(ast.Not(), test))
        case _:
            pass


def _text(node: ast.AST) -> bool:
    return isinstance(node, ast.Constant) and isinstance(node.value, str)


def mutated(source: str, name: str, number: int) -> ast.Module:
    """Return a module with one change: of the function so named, the change of this number."""
    module = ast.parse(source)
    function = next(node for found, node in functions(module) if found == name)
    sites(function)[number].make()
    return ast.fix_missing_locations(module)


def probed(source: str, wanted: list[tuple[str, int, int]]) -> ast.Module:
    """Return a module that reports, before each statement that would be changed, the number it is known by."""
    module = ast.parse(source)
    known = dict(functions(module))
    marks: dict[int, list[ast.stmt]] = {}
    for name, number, key in wanted:
        call = ast.Call(ast.Name("_reached_by_test", ast.Load()), [ast.Constant(key)], [])
        marks.setdefault(id(sites(known[name])[number].statement), []).append(ast.Expr(call))
    for node in list(ast.walk(module)):
        for _, value in ast.iter_fields(node):
            if isinstance(value, list):
                value[:] = [new for old in value for new in (*marks.get(id(old), ()), old)]
    return ast.fix_missing_locations(module)


def install() -> None:
    """Load modules as the file in ``CBSR_QA_MUTANTS`` says.

    It holds ``{"modules": {path: [[function, number, key]]}}`` and, where statements are to report which test reached
    them, ``"reached": folder``; else the path's one change is made.
    """
    import builtins

    plan = json.loads(Path(os.environ[VARIABLE]).read_bytes())
    reached = plan.get("reached")
    original = SourceFileLoader.get_code
    seen: set[tuple[str, int]] = set()

    def get_code(loader: SourceFileLoader, fullname: str) -> object:
        wanted = plan["modules"].get(str(loader.path))
        if wanted is None:
            return original(loader, fullname)
        source = Path(loader.path).read_text(encoding="utf-8")
        tree = probed(source, wanted) if reached else mutated(source, *wanted[0][:2])
        return compile(tree, loader.path, "exec", dont_inherit=True)

    def report(key: int) -> None:
        test = os.environ.get("PYTEST_CURRENT_TEST", "").rpartition(" (")[0]
        if (test, key) not in seen:
            seen.add((test, key))
            with (Path(reached) / f"{os.getpid()}.reached").open("a", encoding="utf-8") as file:
                file.write(f"{key}\t{test}\n")

    if not reached:
        _change_loaded(plan["modules"])
    SourceFileLoader.get_code = get_code  # type: ignore[method-assign, assignment]
    builtins._reached_by_test = report  # type: ignore[attr-defined]
    sys.path.append(str(Path(__file__).parent))  # where pytest finds this file as a plugin


def _change_loaded(modules: dict[str, list[tuple[str, int, int]]]) -> None:
    """Change the function in a module that this process, a fork, has loaded already."""
    for module in list(sys.modules.values()):
        path = getattr(module, "__file__", None)
        if path in modules:
            name, number, _ = modules[path][0]
            changed = compile(mutated(Path(path).read_text(encoding="utf-8"), name, number), path, "exec")
            found: object = module
            for part in name.split("."):
                changed = next(c for c in changed.co_consts if getattr(c, "co_name", None) == part)
                found = vars(found)[part]
            while not hasattr(found, "__code__"):
                found = next(
                    getattr(found, one)
                    for one in ("__wrapped__", "fget", "func", "__func__")
                    if getattr(found, one, None) is not None
                )
            found = inspect.unwrap(found)  # type: ignore[arg-type]
            found.__code__ = changed  # type: ignore[attr-defined]


class _Reports:
    """Writes what each test came to; commands that tests run in a fork learn which test runs them."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def pytest_runtest_logreport(self, report: object) -> None:
        if "PYTEST_XDIST_WORKER" in os.environ:  # its controller writes
            return
        line = f"{report.nodeid}\t{report.outcome}\t{report.duration}\n"  # type: ignore[attr-defined]
        with (self._folder / f"{os.getpid()}.tests").open("a", encoding="utf-8") as file:
            file.write(line)

    def pytest_collection_finish(self) -> None:
        command = sys.modules.get("command")
        forked = getattr(command, "_forked", None)

        def told(folder: object, arguments: object, environment: dict[str, str], limit_s: float) -> object:
            name = "PYTEST_CURRENT_TEST"
            return forked(folder, arguments, {name: os.environ.get(name, ""), **environment}, limit_s)

        if forked is not None:
            command._forked = told  # type: ignore[union-attr]


def pytest_configure(config: object) -> None:
    """Record tests, where they shall say what they reach."""
    plan = json.loads(Path(os.environ[VARIABLE]).read_bytes())
    if "reached" in plan:
        config.pluginmanager.register(_Reports(Path(plan["reached"])))  # type: ignore[attr-defined]
