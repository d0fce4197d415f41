"""Finding plugins: one door, lazily, and a plugin that fails takes nothing else down."""

import importlib
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from importlib.metadata import EntryPoint, entry_points
from typing import Any

import pluggy

import cbsr_qa.plugin.hooks as hookspecs
from cbsr_qa.domain.errors import AbortedError, PluginError
from cbsr_qa.plugin.failures import failure
from cbsr_qa.plugin.hooks import PROJECT, Emulator, Example, Kind
from cbsr_qa.system.copies import end_forked_copies
from cbsr_qa.system.words import describe_error

Factory = Callable[..., Any]


@dataclass(frozen=True, slots=True)
class Registration:
    """One thing a plugin added.

    Parameters
    ----------
    target : ``"package.module:factory"``, imported on first use.
    distribution, version : its origin.
    """

    kind: Kind
    name: str
    target: str
    distribution: str
    version: str


@dataclass(frozen=True, slots=True)
class PluginFailure:
    """A plugin that could not be loaded, and why."""

    distribution: str
    entry_point: str
    reason: str

    def __str__(self) -> str:
        return f"plugin distribution {self.distribution} ({self.entry_point}) could not be loaded: {self.reason}"


class Plugins:
    """Installed plugins. Created by :func:`discover`; there is no global instance."""

    def __init__(self) -> None:
        self.manager = pluggy.PluginManager(PROJECT)
        self.manager.add_hookspecs(hookspecs)
        self.failures: list[PluginFailure] = []
        self._registered: dict[tuple[Kind, str], Registration] = {}

    def registrations(self, kind: Kind | None = None) -> tuple[Registration, ...]:
        """Registered plugins, sorted by kind and name."""
        chosen = (r for r in self._registered.values() if kind in (None, r.kind))
        return tuple(sorted(chosen, key=lambda r: (r.kind, r.name)))

    def names(self, kind: Kind) -> tuple[str, ...]:
        return tuple(r.name for r in self.registrations(kind))

    def list_names(self, kind: Kind) -> tuple[str, ...]:
        """Names registered under a kind: each distribution's in its own order, the built-ins' first."""
        return tuple(r.name for r in self._registered.values() if r.kind is kind)

    def factory(self, kind: Kind, name: str) -> Factory:
        """Import the factory of a name.

        Raises
        ------
        PluginError
            If the name is not registered, or its module cannot be imported; names plugins that failed to load.
        """
        registration = self._registered.get((kind, name))
        if registration is None:
            raise self.unknown(kind, name)
        module, _, attribute = registration.target.partition(":")
        try:
            with end_forked_copies():
                factory: Factory = getattr(importlib.import_module(module), attribute)
        except BaseException as error:
            raise PluginError(
                f"{kind} plugin {name!r} of {registration.distribution} cannot be loaded: {failure(error)}",
                remedy="repair or uninstall that distribution",
            ) from error
        return factory

    def tell(self, hook: str, warn: Callable[[str], None], *, may_abort: bool = False, **arguments: object) -> None:
        """Call every implementation of a hook, each in its own ``try``: one that fails silences no other.

        Parameters
        ----------
        hook : name of the hook.
        warn : called with implementations that fail.
        may_abort : whether an implementation may stop the run.
        arguments : of the hook.

        Raises
        ------
        AbortedError
            If one wants the run stopped, and may.
        """
        for implementation in getattr(self.manager.hook, hook).get_hookimpls():
            try:
                with end_forked_copies():
                    implementation.function(**{name: arguments[name] for name in implementation.argnames})
            except BaseException as error:
                if may_abort and isinstance(error, AbortedError):
                    raise
                warn(f"plugin {implementation.plugin_name} failed in {hook}: {failure(error)}")

    def ask(self, hook: str, limit_s: float, **arguments: object) -> list[tuple[str, object, str]]:
        """Ask every implementation of a hook at once, each in a thread of its own.

        Parameters
        ----------
        limit_s : how long to wait for all of them [s]; a thread that has not answered is left behind.

        Returns
        -------
        Name of the plugin, its answer, and why there is none (empty where there is one).
        """
        implementations = getattr(self.manager.hook, hook).get_hookimpls()
        answers: list[tuple[object, str] | None] = [None] * len(implementations)

        def call(number: int) -> None:
            one = implementations[number]
            try:
                with end_forked_copies():
                    answers[number] = one.function(**{name: arguments[name] for name in one.argnames}), ""
            except BaseException as error:  # noqa: BLE001 - a plugin's code may raise anything
                answers[number] = None, describe_error(error)

        threads = [threading.Thread(target=call, args=(n,), daemon=True) for n in range(len(implementations))]
        for thread in threads:
            thread.start()
        ends_s = time.monotonic() + limit_s
        for thread in threads:
            thread.join(max(ends_s - time.monotonic(), 0.0))
        late = None, f"no answer within {limit_s:g} s"
        return [
            (one.plugin_name, *(answer or late)) for one, answer in zip(implementations, tuple(answers), strict=True)
        ]

    def example(self, kind: Kind, name: str) -> Example | None:
        """Return how the distribution of a plugin wants it tried; None if it does not say.

        PluginError if the plugin is unknown; what its hook raises is not caught.
        """
        answer: Example | None = self._ask_owner(kind, name, "cbsr_example", {"kind": kind, "name": name})
        return answer

    def emulator(self, driver: str) -> Emulator | None:
        """Return what emulates instruments of a driver, as its distribution says; None if it does not say.

        PluginError if the driver is unknown; what its hook raises is not caught.
        """
        answer: Emulator | None = self._ask_owner(Kind.INSTRUMENT, driver, "cbsr_emulator", {"driver": driver})
        return answer

    def _ask_owner(self, kind: Kind, name: str, hook: str, arguments: Mapping[str, object]) -> Any:
        """Return the first answer of the hooks of the distribution that registered a plugin."""
        registration = self._registered.get((kind, name))
        if registration is None:
            raise self.unknown(kind, name)
        answers: Iterable[Any] = (
            implementation.function(**{key: arguments[key] for key in implementation.argnames})
            for implementation in getattr(self.manager.hook, hook).get_hookimpls()
            if implementation.plugin_name.startswith(f"{registration.distribution}:")
        )
        with end_forked_copies():
            return next((answer for answer in answers if answer is not None), None)

    def load(self, point: EntryPoint, distribution: str, version: str) -> None:
        """Import the module of an entry point and take it in; a failure is kept."""
        try:
            with end_forked_copies():
                module = point.load()
        except BaseException as error:  # noqa: BLE001 - a plugin's code may raise anything
            self.failures.append(PluginFailure(distribution, point.name, failure(error)))
        else:
            self.add(module, distribution, version, point.name)

    def add(self, plugin: object, distribution: str, version: str, entry_point: str) -> None:
        """Take in one plugin; whatever it does wrong is kept as a failure."""
        pending: dict[tuple[Kind, str], Registration] = {}

        def register(kind: Kind, name: str, target: str) -> None:
            key = (Kind(kind), name)
            if taken := self._registered.get(key) or pending.get(key):
                raise ValueError(f"{kind} {name!r} is already registered by {taken.distribution}")
            if ":" not in target:
                raise ValueError(f"target {target!r} of {kind} {name!r} is not 'package.module:factory'")
            pending[key] = Registration(key[0], name, target, distribution, version)

        try:
            self.manager.register(plugin, name=f"{distribution}:{entry_point}")
            hook = getattr(plugin, "cbsr_register", None)
            if hook is not None:
                with end_forked_copies():
                    hook(register)
        except BaseException as error:  # noqa: BLE001 - a plugin's code may raise anything
            if self.manager.is_registered(plugin):
                self.manager.unregister(plugin)
            self.failures.append(PluginFailure(distribution, entry_point, failure(error)))
        else:
            self._registered |= pending

    def unknown(self, kind: Kind | None, name: str) -> PluginError:
        """Return the refusal of an unregistered name; ``kind`` None means all kinds."""
        known = sorted({registration.name for registration in self.registrations(kind)})
        near = get_close_matches(name, known, n=1)
        hint = f"did you mean {near[0]!r}? " if near else ""
        parts = ["cbsr-qa plugins list lists them" if kind is None else f"installed: {', '.join(known) or 'none'}"]
        parts += [f"{f.distribution} failed to load: {f.reason}" for f in self.failures]
        of_kind = "plugin" if kind is None else f"{kind} plugin"
        return PluginError(f"there is no {of_kind} named {name!r}", remedy=hint + "; ".join(parts))


def discover(*, blocked: Iterable[str] = (), found: Iterable[EntryPoint] | None = None) -> Plugins:
    """Load every installed plugin, each in its own ``try``.

    Parameters
    ----------
    blocked : distributions to leave out.
    found : entry points to use instead of the installed ones.
    """
    plugins = Plugins()
    available = entry_points(group=PROJECT) if found is None else found
    # The built-ins go first, so that third parties cannot take their names.
    for point in sorted(available, key=lambda p: (_provenance(p)[0] != "cbsr-qa", _provenance(p))):
        distribution, version = _provenance(point)[:2]
        if distribution not in set(blocked):
            plugins.load(point, distribution, version)
    return plugins


def name_left_threads(before: Iterable[threading.Thread]) -> list[str]:
    """Name new threads that would delay the end of the program."""
    names = sorted(thread.name for thread in set(threading.enumerate()) - set(before) if not thread.daemon)
    return [f"thread {name!r} of a plugin is still running, and is not waited for" for name in names]


def _provenance(point: EntryPoint) -> tuple[str, str, str]:
    if point.dist is None:
        return "unknown", "unknown", point.name
    return point.dist.name, point.dist.version, point.name
