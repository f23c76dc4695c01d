"""Presets of a configuration: by name, in a data file of a package."""

from typing import TypeVar

from barn_worlds.base.config import replace_dotted
from barn_worlds.base.text_files import packaged_yaml

T = TypeVar("T")


def read_presets(package: str, file: str, standard: T) -> dict[str, T]:
    """Return the configurations of a file in a package's data, by name.

    The file has of each what it changes, nested as the configuration is: of the one before it that it names as its
    base, or else of the standard one.
    """
    found: dict[str, T] = {}
    for name, changes in packaged_yaml(package, file).items():
        base = found[changes.pop("base")] if "base" in changes else standard
        found[name] = replace_dotted(base, changes, f"{file}: {name}")
    return found
