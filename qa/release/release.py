"""What a release says of itself.

python qa/release/release.py check v0.2.0 # the tag is the version that the suite
states, and the changelog has it python qa/release/release.py notes 0.2.0 # its part of
the changelog python qa/release/release.py citation ADDRESS # CITATION.cff with the
address of the repository that releases it
"""

import re
from pathlib import Path

import click

ROOT = Path(__file__).resolve().parents[2]


@click.group()
def main() -> None:
    """Check a release, and print what goes with it."""


@main.command()
@click.argument("tag")
def check(tag: str) -> None:
    """Exit with 1 unless the tag is that of the version in CITATION.cff, and the changelog has notes on it."""
    (version,) = re.findall(
        r"(?m)^version: (.+)$", (ROOT / "CITATION.cff").read_text("utf-8")
    )
    if tag != f"v{version}":
        raise click.ClickException(
            f"the tag is {tag}, the suite is {version}: v{version} is due"
        )
    notes_on(version)


@main.command()
@click.argument("version")
def notes(version: str) -> None:
    """Print what the changelog says of a version."""
    click.echo(notes_on(version))


@main.command()
@click.argument("address")
def citation(address: str) -> None:
    """Print CITATION.cff with where the suite can be had."""
    click.echo(
        (ROOT / "CITATION.cff").read_text("utf-8") + f"repository-code: {address}",
        nl=True,
    )


def notes_on(version: str) -> str:
    """Return the text of a version's part of the changelog."""
    parts = re.split(
        r"(?m)^## \[(.+?)\].*$", (ROOT / "CHANGELOG.md").read_text("utf-8")
    )
    sections = dict(zip(parts[1::2], parts[2::2], strict=True))
    if not sections.get(version, "").strip():
        raise click.ClickException(
            f"CHANGELOG.md has nothing on {version}; it has {', '.join(sections)}"
        )
    return sections[version].strip()


if __name__ == "__main__":
    main()
