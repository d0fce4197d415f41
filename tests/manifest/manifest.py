"""What users and other programs rely on, read from the program itself: one JSON document for each subject.

``python tests/manifest/manifest.py`` writes them beside this file. Do so only where a change is meant.
"""

import enum
import importlib
import inspect
import json
import pkgutil
import re
import tempfile
import typing
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pydantic
from sqlalchemy import create_engine, text
from typer.main import get_command

import cbsr_qa
from cbsr_qa import config
from cbsr_qa.cli.command import commands, documents
from cbsr_qa.cli.main import app
from cbsr_qa.config.documents import DocumentKind, list_shipped
from cbsr_qa.config.tables import FileModel
from cbsr_qa.domain.kept import walk_fields
from cbsr_qa.domain.plan import steps
from cbsr_qa.domain.results.calibration import Calibration
from cbsr_qa.plugin import hooks, instruments, interfaces
from cbsr_qa.report.document import json_schema
from cbsr_qa.store.schema import upgrade
from cbsr_qa.studies import gauge
from cbsr_qa_plugins.registry import BUILT_IN

FOLDER = Path(__file__).parent
_ARRAY_LIKE = re.compile(r"Union\[numpy\._typing\._array_like\._Buffer.*?\[complex \| bytes \| str\](, NoneType)?\]")


def read_commands() -> Any:
    """Return the arguments and options of every command, without their help."""
    described = {}
    for command in commands():
        typed: Any = get_command(app)
        for word in command.words.split():
            typed = typed.commands[word]
        described[command.words] = [_describe_parameter(parameter) for parameter in typed.params]
    return described


def _describe_parameter(parameter: Any) -> dict[str, Any]:
    return {
        "names": [*parameter.opts, *parameter.secondary_opts],
        "kind": parameter.param_type_name,
        "type": _spell(parameter.type_descriptor.annotation),
        "value": parameter.metavar,
        "least": parameter.min,
        "most": parameter.max,
        "required": parameter.required,
        "repeated": bool(getattr(parameter, "multiple", False)) or parameter.nargs == -1,
        "flag": bool(getattr(parameter, "is_flag", False)),
        "environment": parameter.envvar,
        "default": repr(parameter.default),
    }


def read_documents() -> Any:
    """Return the JSON Schema of every document that is printed or sent, without descriptions."""
    return {words: _without_words(json_schema(kind)) for words, kind in documents().items()}


def _without_words(schema: Any) -> Any:
    if isinstance(schema, dict):
        properties = schema.get("properties", {})
        bare = {key: _without_words(value) for key, value in schema.items() if key not in ("description", "title")}
        return bare | ({"properties": {k: _without_words(v) for k, v in properties.items()}} if properties else {})
    return [_without_words(one) for one in schema] if isinstance(schema, list) else schema


def read_calibration_file() -> Any:
    """Return the datasets of a calibration file, and how each is kept."""
    return {path: _describe_kept(field) for path, field in walk_fields(Calibration)}


def _describe_kept(field: Any) -> dict[str, Any]:
    kept = {name: getattr(field.kept, name) for name in field.kept.__dataclass_fields__ if name != "path"}
    return {"type": _spell(field.hint), **{name: _plain(value) for name, value in kept.items()}}


def read_database() -> Any:
    """Return the statements that make a new SQLite database, by the name of what they make."""
    with tempfile.TemporaryDirectory() as folder:
        engine = create_engine(f"sqlite:///{folder}/new.db")
        upgrade(engine)
        with engine.connect() as connection:
            made = connection.execute(text("SELECT name, sql FROM sqlite_master WHERE sql IS NOT NULL")).all()
        engine.dispose()
    return {name: " ".join(statement.split()) for name, statement in made}


def read_configuration() -> Any:
    """Return the keys of configuration files: the JSON Schema of each kind of file, without descriptions."""
    for package in (config, gauge):  # the latter reads two kinds of file
        for module in pkgutil.iter_modules(package.__path__, f"{package.__name__}."):
            importlib.import_module(module.name)
    files = {model.__name__: model for model in _subclasses(FileModel) if "[" in model.__base__.__name__}
    assert len(files) == len(DocumentKind)
    return {name: _model_schema(model) for name, model in sorted(files.items())}


def _subclasses(kind: type) -> list[type]:
    return [one for child in kind.__subclasses__() for one in (child, *_subclasses(child))]


def _model_schema(model: Any) -> Any:
    try:
        return _without_words(model.model_json_schema())
    except pydantic.PydanticInvalidForJsonSchema:
        return {name: _spell(field.annotation) for name, field in model.model_fields.items()}


def read_python() -> Any:
    """Return what ``import cbsr_qa as qa`` offers."""
    return {name: _describe_object(getattr(cbsr_qa, name)) for name in sorted(cbsr_qa.__all__)}


def read_plugin_interface() -> Any:
    """Return hooks, kinds, Protocols, and the names and options of the built-in plugins."""
    specified = {name: one for name, one in vars(hooks).items() if name.startswith("cbsr_")}
    protocols = {
        name: _describe_object(one)
        for module in (interfaces, instruments)
        for name, one in vars(module).items()
        if inspect.isclass(one) and one.__module__ == module.__name__
    }
    return {
        "hooks": {name: _spell_signature(one).replace("'", "") for name, one in specified.items()},  # quoted types
        "kinds": [kind.value for kind in hooks.Kind],
        "interfaces": dict(sorted(protocols.items())),
        "built-in": {f"{kind} {name}": _describe_options(place) for kind, name, place in BUILT_IN},
    }


def _describe_options(place: str) -> Any:
    module, _, name = place.partition(":")
    factory = getattr(importlib.import_module(f"cbsr_qa_plugins.{module}"), name)
    options = getattr(factory, "Options", None) or getattr(factory, "options", None)
    if isinstance(options, type) and issubclass(options, pydantic.BaseModel):
        return _model_schema(options)
    return _spell_signature(factory)


def _describe_object(value: Any) -> Any:
    if inspect.isclass(value) and issubclass(value, enum.Enum):
        return {member.name: _plain(member.value) for member in value}
    if inspect.isclass(value):
        public = {name: member for name, member in inspect.getmembers(value) if not name.startswith("_")}
        fields = {name: _spell(hint) for name, hint in getattr(value, "__annotations__", {}).items()}
        methods = {name: _spell_signature(one) for name, one in public.items() if inspect.isfunction(one)}
        return {"fields": fields, "methods": methods, "others": sorted(set(public) - set(methods) - set(fields))}
    return _spell_signature(value) if callable(value) else repr(value)


def _spell_signature(function: Any) -> str:
    return _shorten(str(inspect.signature(function)))


def _spell(hint: Any) -> str:
    if typing.get_origin(hint) is typing.Annotated:
        hint = typing.get_args(hint)[0]
    return hint.__qualname__ if inspect.isclass(hint) and not typing.get_args(hint) else _shorten(str(hint))


def _shorten(text: str) -> str:
    """Leave out where names come from: that may change."""
    return re.sub(r"\b(?:[a-zA-Z_]\w*\.)+(?=[A-Za-z_])", "", _ARRAY_LIKE.sub("ArrayLike", text))


def _plain(value: Any) -> Any:
    try:
        json.dumps(value)
    except TypeError:
        return repr(value)
    return value


def read_names() -> Any:
    """Return names that are stored or typed, beyond those of the other subjects."""
    cases = importlib.import_module("cbsr_qa.studies.hard_cases.cases").all_cases()
    return {
        "hard cases": sorted(case.name for case in cases),
        "steps": [step.__name__ for step in typing.get_args(steps.Step)],
        "shipped files": {kind.noun: list_shipped(kind) for kind in DocumentKind},
    }


#: Each subject, by the name of its file.
SUBJECTS: dict[str, Callable[[], Any]] = {
    "commands": read_commands,
    "documents": read_documents,
    "calibration-file": read_calibration_file,
    "database": read_database,
    "configuration": read_configuration,
    "names": read_names,
    "python": read_python,
    "plugin-interface": read_plugin_interface,
}


def spell_subject(subject: str) -> str:
    """Return the document of a subject as it is stored."""
    return json.dumps(SUBJECTS[subject](), indent=1, sort_keys=True, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    for each in SUBJECTS:
        (FOLDER / f"{each}.json").write_text(spell_subject(each), encoding="utf-8")
