"""Ask a service which locked packages have known vulnerabilities (`make audit`).

Exit code 1 if one has, 2 if the service could not be asked.
"""

import json
import subprocess
import sys
from pathlib import Path

NAMES = ("base.lock", "docs.lock", "extra.lock", "torch.in")
LOCKS = tuple(f"requirements/{name}" for name in NAMES)
ROOT = Path(__file__).resolve().parents[2]


def audit(lock: str) -> tuple[int, list[str], str]:
    """Return how many packages of a lock file were audited, and their vulnerabilities.

    The last text says why not all packages were.
    """
    words = [
        "uvx",
        "pip-audit",
        "--requirement",
        lock,
        "--disable-pip",
        # torch has no hashes, and each lock has all that its packages need.
        "--no-deps",
        "--format",
        "json",
    ]
    try:
        ended = subprocess.run(
            words, cwd=ROOT, capture_output=True, text=True, check=False
        )
        packages = json.loads(ended.stdout)["dependencies"]
    except FileNotFoundError:
        return 0, [], "uv is not installed"
    except (ValueError, KeyError):
        return 0, [], " ".join(ended.stderr.split())[-300:]
    flaws = []
    for package in packages:
        for flaw in package.get("vulns", []):
            versions = ", ".join(flaw["fix_versions"]) or "none"
            name = f"{package['name']} {package['version']}"
            flaws.append(f"{lock}: {name}: {flaw['id']}, fixed in {versions}")
    skipped = [package["name"] for package in packages if "skip_reason" in package]
    why = (
        f"{len(skipped)} packages are not known to the service, such as {skipped[0]}"
        if skipped
        else ""
    )
    return len(packages) - len(skipped), flaws, why


def main() -> int:
    """Print what was found."""
    code = 0
    for lock in LOCKS:
        count, flaws, why = audit(lock)
        note = f"; {why}" if why else ""
        print(
            f"{lock}: {count} packages audited, "
            f"{len(flaws)} known vulnerabilities{note}"
        )
        print(*flaws, sep="\n" if flaws else "", end="\n" if flaws else "")
        if not count:
            print(
                f"{lock}: NOT AUDITED: the service cannot be asked from here",
                file=sys.stderr,
            )
        code = max(code, 2 if not count else int(bool(flaws)))
    return code


if __name__ == "__main__":
    sys.exit(main())
