"""YAML loaders that read scalars such as 10, 1e-3 and yes as other programs do.

PyYAML reads YAML 1.1, in which `no` is false, 10:20 is 620 and 5e-1 is a text. The
suite's own files are read as YAML 1.2, others as the programs do that use them.
"""

import re
from collections.abc import Hashable
from typing import TYPE_CHECKING, Any

import yaml

from barn_worlds.base.errors import refuse_duplicates

_TAG = "tag:yaml.org,2002:"
_FLOAT = r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?"
_INFINITY = r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)"
TRUE = frozenset("y Y yes Yes YES true True TRUE on On ON".split())  # noqa: SIM905
FALSE = frozenset("n N no No NO false False FALSE off Off OFF".split())  # noqa: SIM905
if TYPE_CHECKING:
    _Base = yaml.SafeLoader
else:
    # The loader of libyaml is ten times faster than that of Python.
    _Base = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


class _UniqueKeyLoader(_Base):
    """Safe loader that refuses repeated keys.

    yaml-cpp reads the first of them, PyYAML the last.
    """

    def construct_mapping(
        self, node: yaml.MappingNode, deep: bool = False
    ) -> dict[Hashable, Any]:
        """Return the data in a node; ValueError if a key occurs twice."""
        refuse_duplicates(str(key.value) for key, _ in node.value)
        return super().construct_mapping(node, deep)


class TextLoader(_UniqueKeyLoader):
    """Safe loader that reads every scalar as text."""


class CoreLoader(_UniqueKeyLoader):
    """Safe loader of the core schema of YAML 1.2."""

    def construct_integer(self, node: yaml.ScalarNode) -> int:
        """Return an integer by YAML 1.2: 010 is ten, 0o10 eight, 0x10 sixteen."""
        text = self.construct_scalar(node)
        return int(text, 0 if text.startswith(("0o", "0x")) else 10)


class RosLoader(_UniqueKeyLoader):
    """Safe loader of ROS parameter files, by the rules of rcl_yaml_param_parser."""

    def construct_flag(self, node: yaml.ScalarNode) -> bool:
        """Return True or False for a word such as yes or off; else ValueError."""
        text = self.construct_scalar(node)
        if text not in TRUE | FALSE:
            raise ValueError(f"{text!r:.60} is neither true nor false")
        return text in TRUE

    def construct_integer(self, node: yaml.ScalarNode) -> int:
        """Return an integer as C reads it: 010 is eight, 0x10 sixteen."""
        text = self.construct_scalar(node)
        if re.fullmatch("[-+]?0[0-7]+", text):
            return int(text, 8)
        return int(text, 0)


class Dumper(yaml.SafeDumper):
    """Safe dumper that quotes text that a loader would read as something else."""


def parse_numbers(value: Any) -> Any:
    """Return text as float where yaml-cpp would, also in lists; anything else as is."""
    if isinstance(value, list):
        return [parse_numbers(item) for item in value]
    if isinstance(value, str) and re.fullmatch(f"{_FLOAT}|{_INFINITY}", value):
        return float(value.lower().replace(".i", "i").replace(".n", "n"))
    return value


def parse_flag(text: str) -> int | str:
    """Return a flag of yaml-cpp as 0 or 1, an integer as int, any other text as is."""
    if text in TRUE | FALSE:
        return int(text in TRUE)
    return int(text) if re.fullmatch("[-+]?[0-9]{1,9}", text) else text


# Without the rules of YAML 1.1; each loader gets a copy with its own.
_UniqueKeyLoader.yaml_implicit_resolvers = {}


def _declare(loader: Any, name: str, pattern: str, constructor: Any = None) -> None:
    """Make a loader read a pattern's scalars as type `name`, `Dumper` quote them."""
    tag = _TAG + name
    expression = re.compile(rf"(?:{pattern})\Z")
    loader.add_implicit_resolver(tag, expression, None)
    if constructor:
        loader.add_constructor(tag, constructor)
    # No text has this tag, so the dumper quotes texts that fit the pattern.
    Dumper.add_implicit_resolver(f"{_TAG}{name}.other", expression, None)


_declare(CoreLoader, "null", "~|null|Null|NULL|")
_declare(CoreLoader, "bool", "true|True|TRUE|false|False|FALSE")
_declare(
    CoreLoader,
    "int",
    "[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+",
    CoreLoader.construct_integer,
)
_declare(CoreLoader, "float", f"{_FLOAT}|{_INFINITY}")
_declare(RosLoader, "bool", "|".join(sorted(TRUE | FALSE)), RosLoader.construct_flag)
_declare(
    RosLoader,
    "int",
    "[-+]?(0[xX][0-9a-fA-F]+|0[0-7]*|[1-9][0-9]*)",
    RosLoader.construct_integer,
)
_declare(RosLoader, "float", rf"{_FLOAT}|{_INFINITY}|[-+]?(?i:inf|infinity|nan)")
