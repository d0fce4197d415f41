"""Creating plugins with their options."""

from typing import Any

from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.plan.plan import PluginChoice
from cbsr_qa.plugin.discovery import Plugins
from cbsr_qa.plugin.failures import blame_plugin
from cbsr_qa.plugin.hooks import Kind
from cbsr_qa.plugin.options import options_of


def create_plugin(plugins: Plugins, kind: Kind, choice: PluginChoice, where: str) -> Any:
    """Create an instance of a plugin with its options.

    Raises
    ------
    PluginError
        If the plugin is unknown, cannot be loaded, or its factory fails.
    ConfigError
        If it refuses its options; the message names their origin.
    """
    factory, who = plugins.factory(kind, choice.name), f"{where}: {kind} {choice.name!r}"
    try:
        with blame_plugin(who):
            options_of(factory).read(choice.options)
            return factory(**choice.options)
    except ConfigError as error:
        raise ConfigError(f"{who}: {error.reason}", remedy=error.remedy) from error
