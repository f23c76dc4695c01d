"""Selecting worlds with a short text such as `0-49` or `0:300:6`."""

import re
from collections.abc import Iterable

from barn_worlds.base.errors import WorldError

LONGEST_SPEC = 10_000
_NUMBER = r"(\d{1,9})"
_SINGLE = re.compile(_NUMBER)
_SPAN = re.compile(rf"{_NUMBER}-{_NUMBER}")
_SLICE = re.compile(rf"{_NUMBER}:{_NUMBER}(?::{_NUMBER})?")
_FORMS = "a number, first-last, start:stop or start:stop:step, several joined by commas, or all"


def select_worlds(spec: str, indices: Iterable[int]) -> list[int]:
    """Return the numbers that `spec` selects from `indices`, in its order, each once.

    "7" must exist. The ranges "0-49" (both ends included) and "0:300:6" (like a Python range, end excluded) select the
    numbers that exist, at least one. "1,4,7-9" joins, "all" is all. WorldError for anything else.
    """
    known = sorted(set(indices))
    if len(spec) > LONGEST_SPEC:
        raise WorldError(f"selection of worlds must have at most {LONGEST_SPEC} characters, got {len(spec)}")
    if not known:
        raise WorldError("there are no worlds to select from")
    chosen: dict[int, None] = {}
    for part in spec.split(","):
        chosen.update(dict.fromkeys(_part(part.strip(), spec, known)))
    return list(chosen)


def _part(part: str, spec: str, known: list[int]) -> list[int]:
    if part == "all":
        return known
    if match := _SINGLE.fullmatch(part):
        wanted = range(int(match[1]), int(match[1]) + 1)
    elif match := _SPAN.fullmatch(part):
        wanted = range(int(match[1]), int(match[2]) + 1)
    elif match := _SLICE.fullmatch(part):
        if match[3] is not None and int(match[3]) == 0:
            raise WorldError(f"worlds {spec!r:.80}: the step in {part!r} must be at least 1")
        wanted = range(int(match[1]), int(match[2]), int(match[3] or 1))
    else:
        raise WorldError(f"worlds {spec!r:.80}: {part!r:.40} is not {_FORMS}")
    found = [index for index in known if index in wanted]
    if not found:
        raise WorldError(f"worlds {spec!r:.80}: no world {part} among the {len(known)} from {known[0]} to {known[-1]}")
    return found
