"""A configuration checks itself and says in one line what is wrong."""

from dataclasses import dataclass, field

import pytest

from barn_worlds.config import Checked, as_dict, fields_of, from_dict, quantity, replace_dotted
from barn_worlds.errors import ConfigError


@dataclass(frozen=True)
class Inner(Checked):
    length_m: float = quantity(1.0, "a length", "m", minimum=0.0)
    kind: str = quantity("plain", "a kind", choices=("plain", "yellow"))


@dataclass(frozen=True)
class Outer(Checked):
    count: int = quantity(3, "a count", minimum=1)
    inner: Inner = field(default_factory=Inner)


@pytest.mark.parametrize(
    ("mapping", "message"),
    [
        ({"count": 0}, "Outer.count must be at least 1, got 0"),
        ({"count": 1.5}, "count must be int, got 1.5"),
        ({"count": True}, "count must be int, got True"),
        ({"cuont": 1}, "unknown key 'cuont'; did you mean 'count'?"),
        ({"inner": {"lenght_m": 1}}, "unknown key 'inner.lenght_m'; did you mean 'length_m'?"),
        ({"inner": {"length_m": -1.0}}, "Inner.length_m must be at least 0 m, got -1.0"),
        ({"inner": {"length_m": float("nan")}}, "Inner.length_m must be at least 0 m, got nan"),
        ({"inner": {"length_m": "1"}}, "inner.length_m must be float, got '1'"),
        ({"inner": {"kind": "yelow"}}, "did you mean 'yellow'?"),
        ({"inner": 3}, "inner must be a mapping"),
        ([], "must be a mapping"),
    ],
)
def test_what_is_wrong_is_named(mapping, message):
    with pytest.raises(ConfigError) as caught:
        from_dict(Outer, mapping, "file.yaml")
    assert str(caught.value).startswith("file.yaml: ")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_round_trip_and_integers_as_floats():
    config = from_dict(Outer, {"count": 2, "inner": {"length_m": 4}}, "here")
    assert config == Outer(2, Inner(4.0))
    assert from_dict(Outer, as_dict(config), "here") == config
    assert [name for name, _, _ in fields_of(config)] == ["count", "inner.length_m", "inner.kind"]


def test_dotted_changes():
    assert replace_dotted(Outer(), {"inner.length_m": 2}, "--set").inner.length_m == 2.0
    with pytest.raises(ConfigError, match=r"--set: unknown parameter 'inner.length'; did you mean 'length_m'"):
        replace_dotted(Outer(), {"inner.length": 2}, "--set")
