"""What the machine lacks: a home, space, handles, a language."""

import os
import resource
from functools import partial
from pathlib import Path
from typing import Any

from barn_worlds.base.errors import ExitCode
from fault_cases.campaigns import shifted_clock
from fault_cases.direct import gap_run
from fault_cases.kit import Lab, Skipped, case, ending, hold
from fault_cases.processes import run_undisturbed, same, words
from fault_cases.system import succeeds

FAMILY = "machine"


def _drive(lab: Lab, out: Path | None = None, **how: Any) -> str:
    *options, usual_out = gap_run(lab)
    lab.barn(*options, out or usual_out, "--bags", "all", **how)
    row = lab.rows(out)[0]
    hold(row["outcome"] == "timeout", ending(row))
    return ending(row)


@case(FAMILY)
def no_home(lab: Lab) -> str:
    """HOME is a folder that is not there, and so are the folders for caches and
    settings.

    The run works, with bag and picture.
    """
    gone = str(lab.folder / "gone")
    caches = {"XDG_CACHE_HOME": f"{gone}/c", "XDG_CONFIG_HOME": f"{gone}/s"}
    return _drive(lab, environment={"HOME": gone, **caches})


@case(FAMILY)
def home_that_is_a_file(lab: Lab) -> str:
    """HOME is a file, so that nothing can be made in it.

    The run works, with bag and picture.
    """
    (lab.folder / "file").touch()
    file = str(lab.folder / "file")
    caches = {"MPLCONFIGDIR": f"{file}/m", "XDG_CACHE_HOME": f"{file}/c"}
    return _drive(lab, environment={"HOME": file, **caches})


@case(FAMILY)
def caches_that_cannot_be_written(lab: Lab) -> str:
    """The folder for the machine code of kernels is a file.

    The run works, or is refused in one line.
    """
    (lab.folder / "file").touch()
    cache = lab.folder / "file" / "cache"
    return _drive(lab, environment={"NUMBA_CACHE_DIR": str(cache)})


@case(FAMILY)
def temporary_folder_that_is_not_there(lab: Lab) -> str:
    """TMPDIR is a folder that is not there.

    The run works.
    """
    return _drive(lab, environment={"TMPDIR": str(lab.folder / "gone")})


@case(FAMILY)
def language_without_letters(lab: Lab) -> str:
    """The language is C, without UTF-8, and the folder's name is in Greek.

    The run works, and so does the check.
    """
    out = lab.folder / "αποτελέσματα"
    plain = {"LC_ALL": "C", "LANG": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    description = _drive(lab, out, environment=plain)
    lab.barn("check", out, environment=plain)
    return description


@case(FAMILY)
def few_handles(lab: Lab) -> str:
    """A process may have 64 open files (ulimit -n).

    The run over ROS has the undisturbed row.
    """
    run_undisturbed()
    limit = partial(resource.setrlimit, resource.RLIMIT_NOFILE, (64, 64))
    lab.barn(*words(lab), before=limit)
    return same(lab)


@case(FAMILY)
def too_few_handles(lab: Lab) -> str:
    """A process may have 12 open files.

    The campaign ends with one line that gives the reason, or works; nothing is left.
    """
    limit = partial(resource.setrlimit, resource.RLIMIT_NOFILE, (12, 12))
    ended = lab.barn(*gap_run(lab), "--bags", "none", code=None, before=limit)
    hold(ended.code in (0, ExitCode.REFUSED, ExitCode.NOT_SCORED), ended.text)
    return ended.error[:200] if ended.code else ending(lab.row())


def shared_memory(size: str) -> list[str]:
    """Return what a command begins with whose folder for shared memory is of a size.

    Raises:
        Skipped: Where that cannot be.
    """
    unshared = ["unshare", "--mount", "sh", "-c"]
    hide = f"mount -t tmpfs -o size={size} barn-faults /dev/shm"
    if os.geteuid() != 0 or not succeeds([*unshared, hide]):
        raise Skipped("a mount namespace cannot be made here (needs root)")
    return [*unshared, f'{hide}; exec "$@"', "sh"]


@case(FAMILY)
def hardly_any_shared_memory(lab: Lab) -> str:
    """The folder for shared memory has 16 kB, in a mount namespace of the run's own.

    The run over ROS has the undisturbed row: it needs none but the page that the
    tracing of ROS (LTTng) takes.
    """
    run_undisturbed()
    lab.barn(*words(lab), prefix=shared_memory("16k"))
    return same(lab)


@case(FAMILY)
def a_clock_of_another_century(lab: Lab) -> str:
    """The clock of the machine is 55 years behind.

    The run works.
    """
    _, false = shifted_clock(lab, -55 * 365 * 86_400)
    return _drive(lab, environment=false)
