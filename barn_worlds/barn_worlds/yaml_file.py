"""Reading the YAML files that users write."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from barn_worlds.errors import ConfigError

_LARGEST_FILE_BYTES = 1_000_000


def read_mapping(path: Path, schema_version: int) -> dict[str, Any]:
    """Return the mapping of a file less its `schema_version`, which must be the one given.

    Raises ConfigError in one line for a file that cannot be read, is too large or holds anything else.
    """
    try:
        if path.stat().st_size > _LARGEST_FILE_BYTES:
            raise ConfigError(f"{path}: must have at most {_LARGEST_FILE_BYTES} bytes, got {path.stat().st_size}")
        content = yaml.safe_load(path.read_text("utf-8"))
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror or error}") from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: not YAML: {' '.join(str(error).split())}") from None
    if not isinstance(content, dict):
        raise ConfigError(f"{path}: must be a mapping of names to values")
    version = content.pop("schema_version", None)
    if version != schema_version:
        raise ConfigError(f"{path}: schema_version must be {schema_version}, got {version!r}")
    return content
