"""Files of limits that a recipe refers to are taken in by content, so that a stored run needs no file."""

from collections.abc import Mapping
from dataclasses import replace

from cbsr_qa.config.documents import Document, DocumentKind, open_document
from cbsr_qa.config.limit_tables import LimitsFile
from cbsr_qa.config.lines import line_of
from cbsr_qa.config.tables import Problem, refusal, validated
from cbsr_qa.domain.errors import ConfigError


def with_limits(document: Document) -> Document:
    """Put the limits and the version of ``recipe.limits_from``, looked for next to the recipe, behind its own limits.

    Raises
    ------
    ConfigError
        If the file cannot be read or is not sound, or if the recipe limits the same measurement itself.
    """
    recipe = document.data.get("recipe")
    name = recipe.get("limits_from") if isinstance(recipe, Mapping) else None
    if not isinstance(name, str):
        return document
    assert isinstance(recipe, Mapping)
    try:
        taken = open_document(DocumentKind.LIMITS, name, near=document.folder)
        validated(LimitsFile, taken)
    except ConfigError as error:
        line = line_of(document.text, ("recipe", "limits_from"))
        where = f"line {line}: " if line else ""
        raise ConfigError(
            f"{document.label}: {where}recipe.limits_from: {error.reason}", remedy=error.remedy
        ) from error
    own = document.data.get("limits", [])
    problems = list(_problems(document, taken, own)) if isinstance(own, list) else []
    if problems:
        raise refusal(document, problems)
    limits = [*own, *taken.data["limits"]] if isinstance(own, list) else own
    rest = {key: value for key, value in recipe.items() if key != "limits_from"}
    version = taken.data["limits_version"]
    return replace(document, data={**document.data, "recipe": rest, "limits_version": version, "limits": limits})


def _problems(document: Document, taken: Document, own: list[object]) -> list[Problem]:
    """List what both files state."""
    found = []
    if "limits_version" in document.data:
        found.append(Problem(("limits_version",), f"is stated here and in {taken.label}; remove this one"))
    theirs = {_judges(limit) for limit in taken.data["limits"]}
    for index, limit in enumerate(own):
        if isinstance(limit, Mapping) and _judges(limit) in theirs:
            what = f"({limit.get('measurement')}) is limited in {taken.label} too; remove one of them"
            found.append(Problem(("limits", index), what))
    return found


def _judges(limit: Mapping[str, object]) -> tuple[object, object, object]:
    return limit.get("measurement"), limit.get("phase", ""), limit.get("qualifier", "")
