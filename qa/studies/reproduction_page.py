"""Write the page of a reproduction and its figures anew from the numbers beside it.

    python qa/studies/reproduction_page.py docs

This is for changes of wording or figures; `barn reproduce` writes the numbers.
"""

from pathlib import Path

import click

from barn_eval.studies.reproduction.findings import SCHEMA_VERSION, Findings, Origin
from barn_eval.studies.reproduction.page import NAME, write_results
from barn_worlds.base.config import from_dict
from barn_worlds.base.errors import BarnError, ConfigError
from barn_worlds.base.files import read_json


def read_results(folder: Path) -> tuple[Findings, Origin]:
    """Return what `write_results` has written.

    Raises:
        ConfigError: A file has another content or version.
    """
    path = folder / f"{NAME}.json"
    content = read_json(path)
    version = content.get("schema_version") if isinstance(content, dict) else None
    if version != SCHEMA_VERSION:
        raise ConfigError(
            f"{path}: schema_version must be {SCHEMA_VERSION}, got {version!r}"
        )
    origin_path = folder / f"{NAME}_origin.json"
    origin = from_dict(Origin, read_json(origin_path), str(origin_path))
    return from_dict(Findings, content, str(path)), origin


@click.command()
@click.argument("folder", metavar="FOLDER", type=click.Path(path_type=Path))
def main(folder: Path) -> None:
    """Write the page and its figures in FOLDER anew from the numbers in it."""
    try:
        write_results(*read_results(folder), folder)
    except BarnError as error:
        raise click.ClickException(str(error)) from None


if __name__ == "__main__":
    main()
