"""Plain data and JSON: a bounded reader, and numbers that JSON has no word for."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from barn_worlds.errors import ConfigError
from barn_worlds.formats.files import read_at_most

LARGEST_FILE = 64 * 1024 * 1024


def read_json(path: Path, largest: int = LARGEST_FILE) -> Any:
    """Return the content of a JSON file of at most `largest` bytes; ConfigError in one line if it is none."""
    try:
        return json.loads(read_at_most(path, largest))
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror or error}") from None
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{path}: not JSON: {error}") from None


def finite(content: Any) -> Any:
    """Return plain data with None for every number that is not finite, names as texts and tuples as lists."""
    if isinstance(content, dict):
        return {str(key): finite(value) for key, value in content.items()}
    if isinstance(content, (list, tuple)):
        return [finite(value) for value in content]
    return None if isinstance(content, float) and not math.isfinite(content) else content
