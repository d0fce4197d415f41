"""A plugin's options are one model: what it refuses, its reference page and its defaults all follow from it."""

import inspect
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial, update_wrapper
from typing import Any, ClassVar, Final, Generic, Self, TypeVar

from pydantic import BeforeValidator, ConfigDict, Field, create_model

from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.plugin.instruments import StationContext
from cbsr_qa.plugin.problems import CheckedTable, Problem, check
from cbsr_qa.system.words import format_key_path

#: A pair or an array that is written as an array in TOML, and as a tuple in Python.
Array: Final = Field(strict=False)


def _require_whole(value: Any) -> Any:
    if type(value) is not int:
        raise ValueError("it must be a whole number")
    return value


#: For a choice of whole numbers, e.g. ``Annotated[Literal[0, 1, 2], WholeNumber]``: pydantic alone takes true for 1.
WholeNumber: Final = BeforeValidator(_require_whole)


class PluginOptions(CheckedTable):
    """Options of a plugin: a field for each, with its type, range and default; names end in their unit.

    Constraints between options belong in ``problems``.
    """

    @classmethod
    def read(cls, given: Mapping[str, Any]) -> Self:
        """Check options and return them.

        Raises
        ------
        ConfigError
            Naming every option that is unknown, missing or wrong, what was given and what is allowed.
        """
        options, problems = check(cls, given)
        if problems or options is None:
            raise options_error(problems)
        return options


def options_error(problems: list[Problem]) -> ConfigError:
    """Return the error that lists what is wrong with options."""
    found = "; ".join(str(replace(problem, allowed="")) for problem in problems)
    if len(problems) == 1:
        return ConfigError(found, remedy=problems[0].allowed)
    return ConfigError(
        found, remedy="; ".join(f"{format_key_path(p.path)}: {p.allowed}" for p in problems if p.allowed)
    )


class WithOptions:
    """A plugin built from its options: ``Creep(from_s=5)`` reads and checks them by ``Creep.Options``.

    Parameters
    ----------
    options : fields of the class's ``Options``, if any.

    Raises
    ------
    ConfigError
        As of :meth:`PluginOptions.read`.
    """

    Options: ClassVar[type[PluginOptions]] = PluginOptions
    options: PluginOptions

    def __init__(self, **options: Any) -> None:
        self.options = self.Options.read(options)


class _AnyOptions(PluginOptions):
    model_config = ConfigDict(extra="allow")


def options_of(factory: Callable[..., Any], *, handed: int = 0) -> type[PluginOptions]:
    """Return the model of a factory's options: its ``Options``, or its keyword arguments and their defaults.

    Parameters
    ----------
    handed : arguments in front that are no options: the setting of an effect.
    """
    model = getattr(factory, "Options", None)
    if isinstance(model, type) and issubclass(model, PluginOptions):
        return model
    arguments = list(inspect.signature(factory).parameters.values())[handed:]
    if any(a.kind is a.VAR_KEYWORD for a in arguments):
        return _AnyOptions
    fields: dict[str, Any] = {a.name: (Any, ... if a.default is a.empty else a.default) for a in arguments}
    return create_model("Options", __base__=PluginOptions, **fields)


Opts = TypeVar("Opts", bound=PluginOptions)
Opened = TypeVar("Opened")


class Driver(Generic[Opts, Opened]):
    """Opens an instrument: called with a station's context, it checks the options and passes them on.

    Parameters
    ----------
    opens : called with the context and the options.
    """

    def __init__(self, name: str, options: type[Opts], opens: Callable[[StationContext, Opts], Opened]) -> None:
        self.Options = options
        self._name = name
        self._opens = opens
        update_wrapper(self, opens)

    def __call__(self, context: StationContext) -> Opened:
        """Open it.

        Raises
        ------
        ConfigError
            Naming role and wrong options.
        """
        try:
            options = self.Options.read(context.options)
        except ConfigError as error:
            raise ConfigError(
                f"instrument {context.role!r} ({self._name}): {error.reason}", remedy=error.remedy
            ) from error
        return self._opens(context, options)


def driver(
    name: str, options: type[Opts]
) -> Callable[[Callable[[StationContext, Opts], Opened]], Driver[Opts, Opened]]:
    """Make a function the factory of an instrument of this name, with these options."""
    return partial(Driver, name, options)
